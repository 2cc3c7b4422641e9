"""Edited JSON, TOML, tables and headers of text."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from random import Random
from typing import Any

_DEEP = "@deep@"
ODD: tuple[Any, ...] = (None, True, False, -1, 0, 1, 1.5, 3, 10**6, 10**9, 2**63, 10**400, float("nan"), float("inf"))
ODD += (
    -1e308,
    "",
    "x",
    "Hip",
    "\x1b[31m",
    "\ud800",
    "NaN",
    "1",
    [],
    {},
    [[]],
    [1, 2],
    ["a"],
    {"a": 1},
    _DEEP,
    "x" * 4000,
)


def _paths(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [path, *(one for key, value in items for one in _paths(value, (*path, key)))]


def edited(document: Any, chance: Random) -> Any:
    """Set, leave out, rename, repeat or exchange some values of a document."""
    found = json.loads(json.dumps(document))
    for _ in range(chance.choice([1, 1, 2, 5])):
        paths = _paths(found)
        path = chance.choice(paths)
        if not path:
            if chance.random() < 0.1:
                return deepcopy(chance.choice(ODD))
            continue
        parent = found
        for key in path[:-1]:
            parent = parent[key]
        key, kind = path[-1], chance.randrange(8)
        if kind <= 3:
            parent[key] = deepcopy(chance.choice(ODD))
        elif kind == 4:
            del parent[key]
        elif kind == 5 and isinstance(parent, dict):
            parent[chance.choice(["", "x", "n", str(key) + "_"])] = parent.pop(key)
        elif kind == 6 and isinstance(parent, list):
            parent.insert(key, parent[key])
        elif isinstance(parent[key], int | float):
            parent[key] = parent[key] * chance.choice([-1, 2, 3, 10**6])
    return found


def of_json(document: Any, chance: Random) -> str:
    """Write an edited document, in which a value may be nested deeply or be no valid number."""
    depth = chance.choice([200, 100_000])
    text = json.dumps(edited(document, chance), ensure_ascii=chance.random() < 0.5)
    return text.replace(
        f'"{_DEEP}"', chance.choice(["[" * depth + "]" * depth, '{"a":' * depth + "1" + "}" * depth, "["])
    )


def json_edited(whole: bytes, chance: Random) -> bytes:
    """Edit a file of JSON."""
    return of_json(json.loads(whole), chance).encode("utf-8", "surrogatepass")


_VALUES = (
    "",
    "-1",
    "0",
    "1e400",
    "nan",
    "inf",
    '"x"',
    "true",
    "[]",
    "{}",
    "1979-05-27",
    "[" * 20000,
    "[" * 300 + "]" * 300,
)
_VALUES += (
    "9" * 5000,
    "0x" + "f" * 4000,
    '"\\u0000"',
    "{a={a={a=1}}}",
    "[1, 'a']",
    "'''",
    "1_0",
    '"\\uD800"',
    "99999999999",
)


def toml_edited(whole: bytes, chance: Random) -> bytes:
    """Edit lines of a file of TOML."""
    lines = whole.decode().splitlines()
    for _ in range(chance.choice([1, 1, 2])):
        at, kind = chance.randrange(len(lines)), chance.randrange(6)
        key = lines[at].partition("=")[0]
        if kind <= 2:
            lines[at] = f"{key}= {chance.choice(_VALUES)}"
        elif kind == 3:
            lines.insert(at, lines[at])
        elif kind == 4:
            lines[at] = chance.choice(
                ["[model", "[[train]]", "[" + "a." * 5000 + "a]", "x.y.z = 1", "# \x00", "=", lines[at][:-2]]
            )
        else:
            lines[at] = lines[at].replace("=", ".x =", 1)
    return "\n".join(lines).encode()


_CELLS = (
    "",
    "nan",
    "inf",
    "-1e400",
    "1e20",
    "x",
    '"',
    "1,5",
    "\x00",
    "\x1b[31m",
    "=1+1",
    "é",
    "9" * 5000,
    "1e",
    "0x1",
    "None",
)


def table_edited(separator: str) -> Callable[[bytes, Random], bytes]:
    """Edit cells, rows and columns of a table."""

    def table(whole: bytes, chance: Random) -> bytes:
        rows = [line.split(separator) for line in whole.decode().splitlines()]
        for _ in range(chance.choice([1, 1, 3])):
            row, kind = chance.choice(rows), chance.randrange(9)
            column = chance.randrange(len(row)) if row else 0
            if kind <= 3 and row:
                row[column] = chance.choice(_CELLS)
            elif kind == 4:
                rows.insert(chance.randrange(len(rows)), list(row))
            elif kind == 5 and len(rows) > 1:
                rows.remove(row)
            elif kind == 6:
                for some in rows:
                    del some[column : column + 1]
            elif kind == 7:
                for some in rows:
                    some.insert(column, some[column] if column < len(some) else "")
            elif row:
                del row[column]
        end = chance.choice(["\n", "\n", "\r\n", "\r", ""])
        return (
            chance.choice([b"", b"", b"", b"\xef\xbb\xbf", b"\xff\xfe"]) + end.join(map(separator.join, rows)).encode()
        )

    return table
