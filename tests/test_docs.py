"""The pages tell the truth: links lead somewhere, settings exist, nothing of one machine slipped in."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

import outrider
from outrider.settings import Settings

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def name(path):
    return str(path.relative_to(ROOT))


def slugs(page):
    """Anchors of the headings of a page, as the site makes them."""
    heads = re.findall(r"^#+ (.+)$", page.read_text(), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", head).strip().lower().replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_and_pictures_lead_somewhere(page):
    broken = []
    for target in LINK.findall(page.read_text()):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        file, _, anchor = target.partition("#")
        there = (page.parent / file).resolve() if file else page
        if not there.exists() or (anchor and anchor not in slugs(there)):
            broken.append(target)
    assert broken == []


def test_every_page_is_in_the_table_of_contents():
    config = tomllib.loads((ROOT / "zensical.toml").read_text())["project"]

    def files(entry):
        if isinstance(entry, str):
            return [entry]
        return [f for value in (entry.values() if isinstance(entry, dict) else entry) for f in files(value)]

    listed = sorted(files(config["nav"]))
    assert listed == sorted(str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_settings_named_on_a_page_exist(page):
    sections = Settings()
    wrong = []
    for section, key in re.findall(r"(?:--set |`)([a-z]+)\.([a-z]\w+)(?==|`)", page.read_text()):
        if section not in sections.__struct_fields__ or key in {"py", "md"}:
            continue
        code = (
            ROOT / "src" / "outrider" / f"{section}.py"
        )  # or a function of the file with the section's name
        if key not in getattr(sections, section).__struct_fields__ and not (
            code.is_file() and re.search(rf"^(?:def|class) {key}\b", code.read_text(), flags=re.M)
        ):
            wrong.append(f"{section}.{key}")
    assert wrong == []


def test_python_on_the_pages_compiles():
    for page in PAGES:
        for block in re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.S):
            compile(block, name(page), "exec")


def test_the_version_is_the_same_everywhere():
    assert (
        re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), flags=re.M)[1]
        == outrider.__version__
    )
    assert f"## [{outrider.__version__}]" in (ROOT / "CHANGELOG.md").read_text()


def test_no_path_or_host_of_one_machine_is_in_the_repository():
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    if listed.returncode:
        pytest.skip("not a git checkout")
    places = [str(place).encode() + b"/" for place in (ROOT, Path.home()) if len(place.parts) > 1]
    found = []
    for file in filter(None, listed.stdout.split("\0")):
        path = ROOT / file
        if path.is_file() and any(place in path.read_bytes() for place in places):
            found.append(file)
    assert found == []
