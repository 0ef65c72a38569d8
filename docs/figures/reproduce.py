"""Makes reproduce.md anew below its line, and reproduce-*.png, from what `outrider reproduce` computes."""

import re
from pathlib import Path

from outrider.plots import write
from outrider.reproduce import page

DOCS = Path(__file__).parents[1]
LINE = "<!-- below: python docs/figures/reproduce.py -->\n"
KEPT = (
    "case-2",
    "case-3",
    "drift",
    "far-start",
    "theta",
    "experiment-2",
    "experiment-3-low",
    "experiment-3-high",
)


def main():
    """Keep the introduction, replace the rest; pictures that are not kept leave no trace."""
    sections = page.make(page.PARTS, print)
    for picture in (p for s in sections for p in s.pictures if p.name in KEPT):
        write(picture.draw(), DOCS / "figures" / f"reproduce-{picture.name}.png")
    made = page.markdown(sections).partition("\n## ")[2]
    made = re.sub(r"!\[(.*)\]\((.*)\.png\)\n\n\*.*\*\n\n?", _link, "## " + made)
    path = DOCS / "reproduce.md"
    path.write_text(path.read_text().partition(LINE)[0] + LINE + "\n" + made)


def _link(match):
    caption, name = match.groups()
    return f"![{caption}](figures/reproduce-{name}.png)\n\n*{caption}*\n\n" if name in KEPT else ""


if __name__ == "__main__":
    main()
