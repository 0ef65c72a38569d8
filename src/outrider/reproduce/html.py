"""The page as one HTML file that needs no other: pictures inside, a little style, no script."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Sequence
from html import escape
from pathlib import Path

from outrider.reproduce.section import Section, Table

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 70rem;
  margin: 2rem auto; padding: 0 1rem }
table { border-collapse: collapse; margin: 1rem 0; font-size: .9rem }
caption { text-align: left; font-weight: 600; padding: .3rem 0 }
th, td { border-bottom: 1px solid #ddd; padding: .25rem .7rem; text-align: left; vertical-align: top }
td { font-variant-numeric: tabular-nums }
figure { margin: 1.5rem 0 } img { max-width: 100% } figcaption { color: #555 }
code { background: #f2f2f2; padding: 0 .2rem }
"""


def document(title: str, sections: Sequence[Section], folder: Path) -> str:
    """All sections as one page; the pictures are read from `folder`, where they were written."""
    body = [f"<h1>{escape(title)}</h1>"]
    for s in sections:
        if s.title:
            body.append(f'<h2 id="{escape(s.name)}">{escape(s.title)}</h2>')
        body += [_block(text) for text in re.split(r"\n\s*\n", s.text.strip())]
        body += [_table(table) for table in s.tables]
        for p in s.pictures:
            data = b64encode((folder / f"{p.name}.png").read_bytes()).decode()
            image = f'<img alt="{escape(p.caption)}" src="data:image/png;base64,{data}">'
            body.append(f"<figure>{image}<figcaption>{inline(p.caption)}</figcaption></figure>")
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n'
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _block(text: str) -> str:
    """A paragraph, or a list of what begins with a dash."""
    if not text.startswith("- "):
        return f"<p>{inline(text)}</p>"
    items = "".join(f"<li>{inline(item)}</li>" for item in re.split(r"\n- ", text[2:]))
    return f"<ul>{items}</ul>"


def inline(text: str) -> str:
    """Markdown's `code`, **strong** and *emphasis* within a paragraph, everything else escaped."""
    text = escape(text, quote=False)
    for mark, tag in ((r"`([^`]+)`", "code"), (r"\*\*([^*]+)\*\*", "strong"), (r"\*([^*]+)\*", "em")):
        text = re.sub(mark, rf"<{tag}>\1</{tag}>", text)
    return text


def _table(table: Table) -> str:
    head = "".join(f"<th>{inline(cell)}</th>" for cell in table.head)
    rows = "".join("<tr>" + "".join(f"<td>{inline(c)}</td>" for c in row) + "</tr>\n" for row in table.rows)
    return f"<table><caption>{inline(table.title)}</caption>\n<tr>{head}</tr>\n{rows}</table>"
