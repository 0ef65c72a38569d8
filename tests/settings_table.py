"""The tables of docs/settings.md, made from the fields and comments of settings.py.

`python tests/settings_table.py` writes them anew; test_settings.py fails while they differ.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from pathlib import Path

import outrider.settings
from outrider.settings import Settings

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "settings.md"
BEGIN, END = "<!-- tables: begin -->", "<!-- tables: end -->"
UNITS = {"_s": "s", "_m": "m", "_rad": "rad", "_mps": "m/s", "_beams": "beams", "_scans": "scans"}


def comments(source: str) -> dict[int, str]:
    """Text of the comment on each line that has one."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {t.start[0]: t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT}


def unit(key: str, meaning: str) -> str:
    """The unit in brackets at the end of the comment, or the one the key's last letters name."""
    bracket = re.search(r"\[([^\]]+)\]$", meaning)
    if bracket:
        return bracket[1]
    return next((u for suffix, u in UNITS.items() if key.endswith(suffix)), "–")


def sections() -> list[tuple[str, str, list[tuple[str, str, str, str]]]]:
    """Name, first sentence and rows (key, default, unit, meaning) of each section of the settings."""
    source = Path(outrider.settings.__file__).read_text()
    notes = comments(source)
    classes = {n.name: n for n in ast.parse(source).body if isinstance(n, ast.ClassDef)}
    found = []
    for name in Settings.__struct_fields__:
        node = classes[type(getattr(Settings(), name)).__name__]
        rows = []
        for field in node.body:
            if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
                continue
            key = field.target.id
            note = " ".join(notes[i] for i in range(field.lineno, field.end_lineno + 1) if i in notes)
            meaning = re.sub(r"\s*\[[^\]]+\]$", "", note)
            rows.append((key, f"`{ast.unparse(field.value)}`", unit(key, note), meaning))
        found.append((name, ast.get_docstring(node).splitlines()[0], rows))
    return found


def render() -> str:
    """All tables as Markdown."""
    parts = []
    for name, sentence, rows in sections():
        parts += [
            f"## `[{name}]`",
            "",
            sentence,
            "",
            "| key | default | unit | meaning |",
            "|---|---|---|---|",
        ]
        parts += [f"| `{key}` | {value} | {u} | {meaning} |" for key, value, u, meaning in rows]
        parts.append("")
    return "\n".join(parts)


def page(text: str) -> str:
    """The page with what stands between the two marks replaced by the tables."""
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n\n{render()}\n{END}{tail}"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text()))
