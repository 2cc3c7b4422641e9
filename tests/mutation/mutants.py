"""Mutants of a module: its source with one deliberate fault each."""

from __future__ import annotations

import ast
import copy
import re
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Div,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
_PAIRS = (
    ("min", "max"),
    ("minimum", "maximum"),
    ("nanmin", "nanmax"),
    ("argmin", "argmax"),
    ("any", "all"),
    ("floor", "ceil"),
    ("zeros", "ones"),
    ("zeros_like", "ones_like"),
    ("startswith", "endswith"),
)
FUNCTIONS = dict(_PAIRS) | {second: first for first, second in _PAIRS}
METHODS = {**FUNCTIONS, "sum": "mean", "mean": "sum", "median": "mean", "var": "std", "std": "var", "nanmean": "nansum"}
"""Functions of arrays that exist only as attributes (``np.mean``, ``x.mean``)."""
DROPPED = {"axis", "ddof", "side", "where", "initial"}
"""Keyword arguments that are left out."""
LAST_AXIS = {"sort", "argsort", "partition", "argpartition", "take_along_axis", "diff", "trapezoid"}
"""Functions of which axis=-1 is the default."""
SWAPPED_WORDS = {"left": "right", "right": "left", "<": "<=", "<=": "<"}

_LEFT_ALONE = ("annotation", "returns", "decorator_list", "type_params", "bases")
_NO_MUTANT = re.compile(r"#\s*no mutant:\s*\S")


class Mutant(NamedTuple):
    """A module with one fault."""

    path: str
    line: int
    within: str
    """Qualified name of the function or class, empty at the top level."""
    text: str
    """The source line, without indentation."""
    change: str
    """Old and new expression; #2 where the same change can be made twice in the line."""
    source: str
    """The whole module with the fault."""

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What identifies the mutant while lines move."""
        return self.path, self.within, self.text, self.change


def mutants_of(path: str, source: str, strings: bool = False) -> Iterator[Mutant]:
    """Yield every mutant of a module, in the order of its lines; ``strings`` adds changed texts."""
    lines = source.splitlines()
    seen: Counter[tuple[str, str, str]] = Counter()
    for statement in ast.parse(source).body:  # only the statement of a fault is written anew
        module = ast.Module([statement], [])
        first = min(node.lineno for node in (statement, *getattr(statement, "decorator_list", ())))
        before, after = lines[: first - 1], lines[statement.end_lineno :]
        for parent, field, index, node, within in _places(module, ""):
            line = getattr(node, "lineno", 0) or getattr(parent, "lineno", 1)
            last = getattr(node, "end_lineno", line) if isinstance(node, ast.expr) else line
            if any(_NO_MUTANT.search(text) for text in lines[line - 1 : last]):
                continue
            for faulty in _faults(node, field, strings):
                _put(parent, field, index, faulty)
                mutated = "\n".join([*before, ast.unparse(module), *after, ""])
                _put(parent, field, index, node)
                text, change = lines[line - 1].strip(), _difference(ast.unparse(node), ast.unparse(faulty))
                seen[within, text, change] += 1
                number = seen[within, text, change]
                yield Mutant(path, line, within, text, change if number == 1 else f"{change} #{number}", mutated)


def _places(node: ast.AST, within: str) -> Iterator[tuple[ast.AST, str, int | None, ast.AST, str]]:
    """Every node below one, with its parent, field and index: where another can be put."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        within = f"{within}.{node.name}".lstrip(".")
    for field, value in ast.iter_fields(node):
        if field in _LEFT_ALONE:
            continue
        for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(child, ast.AST) and not _is_left_alone(child) and not _is_rest(node, child):
                yield node, field, index, child, within
                if not isinstance(child, ast.UnaryOp) or not isinstance(child.operand, ast.Constant):
                    yield from _places(child, within)


def _is_left_alone(node: ast.AST) -> bool:
    match node:
        case ast.Expr(ast.Constant(str())) | ast.Assert() | ast.Import() | ast.ImportFrom():
            return True
        case ast.If(ast.Name("TYPE_CHECKING") | ast.Attribute(attr="TYPE_CHECKING")):
            return True
        case ast.Assign([ast.Name("__all__" | "__version__")]):
            return True
    return False


def _is_rest(parent: ast.AST, node: ast.AST) -> bool:
    """Whether a node is the -1 of a reshape, which any number below 0 could be."""
    return isinstance(parent, ast.Call) and ast.unparse(parent.func).endswith("reshape") and ast.unparse(node) == "-1"


def _put(parent: ast.AST, field: str, index: int | None, node: ast.AST) -> None:
    if index is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[index] = node


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _faults(node: ast.AST, field: str, strings: bool) -> Iterator[ast.AST]:
    """What may stand in the place of a node."""
    if field in ("test", "ifs") and isinstance(node, ast.Name | ast.Attribute | ast.Call | ast.Subscript):
        yield ast.UnaryOp(ast.Not(), node)
    match node:
        case ast.Compare(ops=ops):
            for at, operator in enumerate(ops):
                for other in COMPARISONS[type(operator)]:
                    yield _with(node, ops=[*ops[:at], other(), *ops[at + 1 :]])
        case ast.BinOp(op=operator) | ast.AugAssign(op=operator) if type(operator) in OPERATORS:
            yield _with(node, op=OPERATORS[type(operator)]())
        case ast.BoolOp(op=operator):
            yield _with(node, op=ast.Or() if isinstance(operator, ast.And) else ast.And())
        case ast.UnaryOp(ast.USub(), ast.Constant(int(value))):  # of a table, 1 would be the same axis as -1
            yield from map(ast.Constant, (1 - value, -1 - value))
        case ast.UnaryOp(ast.USub(), ast.Constant(float(value))):
            yield from map(ast.Constant, (value, -2 * value))
        case ast.UnaryOp(ast.Not() | ast.USub() | ast.Invert(), operand):
            yield operand
        case ast.Constant(value=value):
            yield from map(ast.Constant, _constants(value, strings))
        case ast.Call():
            yield from _calls(node)
        case ast.Return(value) if value is not None and not (isinstance(value, ast.Constant) and value.value is None):
            yield ast.Return(ast.Constant(None))
        case ast.Expr(ast.Call()) | ast.Raise():
            yield ast.Pass()
        case ast.Break():
            yield ast.Continue()
        case ast.Continue():
            yield ast.Break()


def _constants(value: object, strings: bool) -> Iterator[object]:
    match value:
        case bool():
            yield not value
        case int():
            yield from (value + 1, value - 1)
        case float():
            yield value * 2 or 1.0
        case str() if value in SWAPPED_WORDS:
            yield SWAPPED_WORDS[value]
        case str() if strings:
            yield f"{value}XX"


def _calls(call: ast.Call) -> Iterator[ast.AST]:
    match call.func:
        case ast.Name(name) if name in FUNCTIONS:
            yield _with(call, func=_with(call.func, id=FUNCTIONS[name]))
        case ast.Attribute(attr=name) if name in METHODS:
            yield _with(call, func=_with(call.func, attr=METHODS[name]))
        case ast.Attribute(attr="where") if len(call.args) == 3:
            condition, first, second = call.args
            yield _with(call, args=[condition, second, first])
    for at, keyword in enumerate(call.keywords):
        named = call.func.attr if isinstance(call.func, ast.Attribute) else ""
        is_default = keyword.arg == "axis" and named in LAST_AXIS and ast.unparse(keyword.value) == "-1"
        if keyword.arg in DROPPED and not is_default:
            yield _with(call, keywords=[*call.keywords[:at], *call.keywords[at + 1 :]])


def _difference(old: str, new: str) -> str:
    """Old and new text; of long ones what differs, and a little around it."""
    start = end = 0
    if len(old) + len(new) > 120:
        start = max(_same(old, new) - 25, 0)
        end = max(_same(old[start:][::-1], new[start:][::-1]) - 25, 0)
    cut = [" ".join(text[start : len(text) - end].split()) for text in (old, new)]
    cut = [f"{'...' * bool(start)}{text}{'...' * bool(end)}" for text in cut]
    return " -> ".join(text if len(text) <= 80 else f"{text[:77]}..." for text in cut)


def _same(first: str, second: str) -> int:
    """How many characters two texts begin with alike."""
    return next(
        (at for at, (a, b) in enumerate(zip(first, second, strict=False)) if a != b), min(len(first), len(second))
    )
