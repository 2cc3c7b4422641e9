"""A check of LaTeX tables without LaTeX: whole tabulars, rows of as many cells as columns, nothing unescaped."""

from __future__ import annotations

import re


def rows_of(text: str) -> list[list[str]]:
    """Give the rows of all tabulars, cell by cell, and assert that they are well formed."""
    body = one_line("\n".join(line for line in text.splitlines() if not line.startswith("%")))
    body = re.sub(r"\{\\small\n(.*?\\end\{tabular\})\}", r"\1", body, flags=re.DOTALL)
    tabulars = re.findall(r"\\begin\{tabular\}\{(\S+)\}\n(.*?)\\end\{tabular\}", body, re.DOTALL)
    assert len(tabulars) == body.count(r"\begin") == body.count(r"\end") > 0
    found = []
    for columns, lines in tabulars:
        rules = [line for line in lines.splitlines() if line.endswith("rule")]
        assert rules == [r"\toprule", r"\midrule", r"\bottomrule"]
        for line in lines.splitlines():
            if line.endswith("rule"):
                continue
            assert line.endswith(r" \\")
            cells = re.split(r"(?<!\\)&", line.removesuffix(r" \\"))
            assert len(cells) == len(re.sub(r"@?\{\}|[^lr]", "", columns))
            plain = re.sub(r"\\[%&#_$]", "", line)
            assert not re.search("[%#_]", plain)
            assert plain.count("$") % 2 == 0
            assert plain.count("{") == plain.count("}")
            assert plain.isascii() or not re.search("[↓↑−ωτ‖∫√…]", plain)
            found.append([cell.strip() for cell in cells])
    return found


def one_line(text: str) -> str:
    """Join the lines of headings and of words, and drop the size of small text."""
    text = re.sub(r"\\shortstack\[r\]\{((?:[^{}]|\{\})*)\}", _joined, text)
    text = re.sub(r"\\begin\{tabular\}\[t\]\{@\{\}l@\{\}\}(.*?)\\end\{tabular\}", _joined, text)
    return re.sub(r"\{\\footnotesize (\([^()]*\))\}", r"\1", text).replace("~", " ")


def _joined(lines: re.Match[str]) -> str:
    return lines[1].replace(r"\\{}", " ")
