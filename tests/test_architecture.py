"""The layout keeps its promises: imports point down, a library has one door, what is public is documented."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "src" / "outrider"

# Lowest first; a file may import only from rows above its own. A folder stands for all files in it.
LEVELS = [
    {"errors", "geometry", "interrupt", "inequalities"},
    {"extension"},
    {"records", "settings", "kernel", "scenario", "certificate", "family"},
    {"compiler", "claim", "rplidar"},
    {"proof_file"},
    {"models", "envelope", "cars"},
    {"observers"},
    {"ego", "segment", "rectangle", "predictor", "body", "book", "change", "design"},
    {"timing", "associate", "moving", "contact", "metrics", "lidar_model"},
    {"repair", "births", "interval"},
    {"scan", "detect", "tracker", "threat", "alert", "simulate"},
    {"lag", "plots_bounds"},
    {"pipeline", "warm"},
    {"io", "plots", "tally"},
    {"datasets", "log_columns"},
    {"lateral", "relocalise"},
    {"plots_lateral", "plots_relocalise", "plots_tune"},
    {"evaluate"},
    {"compare"},
    {"offline"},
    {"measured", "live"},
    {"comparison"},
    {"plots_compare", "plots_design"},
    {"reproduce"},
    {"__init__"},
    {"cli"},
    {"__main__"},
]
DOORS = {
    "numba": {"compiler"},
    "rosbags": {"io"},
    "mcap": {"io"},
    "foxglove": {"io"},
    "pyarrow": {"io"},
    "matplotlib": {
        "plots",
        "plots_bounds",
        "plots_compare",
        "plots_design",
        "plots_lateral",
        "plots_relocalise",
        "plots_tune",
        "reproduce",
    },
    "pooch": {"datasets"},
    "cyclopts": {"cli"},
    "rich": {"cli"},
    "clarabel": {"design"},
    "serial": {"rplidar"},
    "starlette": {"live"},
    "uvicorn": {"live"},
    "websockets": {"live"},
    "sounddevice": {"live"},
}
FILES = sorted(PACKAGE.rglob("*.py"))
TREES = {path: ast.parse(path.read_text()) for path in FILES}


def unit(path):
    """The part of the package a file belongs to: its folder, or its own name."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def level(name):
    return next((i for i, names in enumerate(LEVELS) if name in names), None)


def imported(tree):
    """Dotted name of everything a file imports, anywhere in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "write imports in full, from outrider..."
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def of_package(tree):
    """Parts of outrider that a file imports; its version belongs to nobody."""
    for name in imported(tree):
        top, *rest = name.split(".")
        if top == "outrider" and rest != ["__version__"]:
            yield rest[0] if rest and level(rest[0]) is not None else "__init__"


def test_every_file_has_its_level():
    assert {unit(path) for path in FILES} == set().union(*LEVELS)


def test_imports_point_down():
    wrong = [
        f"{path.relative_to(PACKAGE)} (level {level(unit(path))}) imports {part} (level {level(part)})"
        for path, tree in TREES.items()
        for part in of_package(tree)
        if part != unit(path) and level(part) >= level(unit(path))
    ]
    assert wrong == []


@pytest.mark.parametrize("library", DOORS)
def test_a_library_has_one_door(library):
    users = {unit(p) for p, tree in TREES.items() for n in imported(tree) if n.split(".")[0] == library}
    assert users <= DOORS[library]


def test_only_the_command_line_prints_or_exits():
    wrong = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path, tree in TREES.items()
        if unit(path) not in {"cli", "__main__"}
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and ast.unparse(node.func) in {"print", "exit", "quit", "sys.exit", "os._exit"}
    ]
    assert wrong == []


def test_no_file_holds_two_ideas():
    lengths = {str(path.relative_to(PACKAGE)): len(path.read_text().splitlines()) for path in FILES}
    assert {name: n for name, n in lengths.items() if n > 400} == {}


def public(body, prefix=""):
    """Functions, classes and methods of public name, with their dotted name."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and node.name[0] != "_":
            yield prefix + node.name, node
            if isinstance(node, ast.ClassDef):
                yield from public(node.body, f"{prefix}{node.name}.")


def test_everything_public_is_documented():
    silent = [
        f"{path.relative_to(PACKAGE)}: {name}"
        for path, tree in TREES.items()
        for name, node in [("module", tree), *public(tree.body)]
        if ast.get_docstring(node) is None and not overrides(node)
    ]
    assert silent == []


def overrides(node):
    """Whether a function says by a decorator that another one's docstring holds for it too."""
    return any(
        "overload" in ast.unparse(d) or "override" in ast.unparse(d)
        for d in getattr(node, "decorator_list", [])
    )


def test_the_first_line_of_a_docstring_is_a_sentence():
    wrong = [
        f"{path.relative_to(PACKAGE)}: {name}: {text.splitlines()[0]}"
        for path, tree in TREES.items()
        for name, node in [("module", tree), *public(tree.body)]
        if (text := ast.get_docstring(node))
        and not text.split("\n\n")[0].rstrip().endswith((".", ":", "!", "?"))
    ]
    assert wrong == []
