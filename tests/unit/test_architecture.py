"""The shape of the code: imports go one way, foreign packages stay where they belong, modules stay small."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "previs"
SOURCES = sorted(PACKAGE.rglob("*.py"))

#: What each part of previs may import of the others; "*" is everything. A part is a module or a sub-package.
ALLOWED = {
    "errors": set(),
    "blackbody": set(),
    "description": {"errors"},
    "settings": {"errors"},
    "vdb": {"errors"},
    "metrics": {"errors"},
    "reference": {"errors"},
    "index": {"description"},
    "meter": {"metrics"},
    "image": {"io", "meter"},
    "io": {"errors", "image"},
    "quality": {"settings"},
    "render": {"errors", "blackbody", "description", "settings", "index", "image", "io", "meter"},
    "stage": {"errors", "description", "settings", "index", "vdb"},
    "scene": {"errors", "blackbody", "description", "settings", "index", "vdb", "stage"},
    "api": {"errors", "description", "quality", "settings", "index", "image", "io", "render", "scene"},
    "ahead": {"errors", "description", "settings", "render", "stage"},
    "__init__": {"*"},
    "commands": {"*"},
    "cli": {"*"},
    "ui": {"*"},
    "bench": {"*"},
}
#: On top: nobody below imports them.
TOP = {"cli", "commands", "ui", "bench"}

#: Foreign packages that may be imported in a few places only.
CONFINED = {
    "pxr": {"stage", "scene"},
    "moderngl": {"render", "ui"},
    "glcontext": {"render", "ui"},
    "OpenImageIO": {"io"},
    "blosc": {"vdb"},
    "flip_evaluator": {"metrics"},
    "imgui_bundle": {"ui"},
    "glfw": {"ui"},
    "matplotlib": {"bench"},
}

LINE_LIMIT = 700
LONG_MODULES: dict[str, str] = {}


def module_name(path: Path) -> tuple[str, ...]:
    return path.relative_to(ROOT).with_suffix("").parts


def part_of(path: Path) -> str:
    """The top-level module or sub-package of previs that a file belongs to."""
    return module_name(path)[1]


def imports(path: Path, source: str) -> set[tuple[str, ...]]:
    """Absolute dotted names that a module imports, anywhere in it; `from a import b` counts as a and as a.b."""
    found = set()
    package = module_name(path)[:-1]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {tuple(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            base += tuple(node.module.split(".")) if node.module else ()
            found |= {(*base, alias.name) for alias in node.names}
    return found


def own_parts(path: Path, source: str) -> set[str]:
    """The parts of previs, other than its own, that a module imports."""
    names = {p.stem if p.is_file() else p.name for p in PACKAGE.iterdir()}
    parts = set()
    for name in imports(path, source):
        if name[0] == "previs":
            parts.add(name[1] if len(name) > 1 and name[1] in names else "__init__")
    return parts - {part_of(path)}


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_one_way(path):
    part = part_of(path)
    assert part in ALLOWED, f"{part} has no place in the order of imports yet"
    allowed = ALLOWED[part]
    used = own_parts(path, path.read_text(encoding="utf-8"))
    if "*" not in allowed:
        assert used <= allowed
    if part not in TOP:
        assert not used & TOP


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_foreign_packages_stay_in_their_place(path):
    foreign = {name[0] for name in imports(path, path.read_text(encoding="utf-8"))}
    for package, places in CONFINED.items():
        if package in foreign:
            assert part_of(path) in places


def test_the_check_of_imports_sees_them():
    path = PACKAGE / "render" / "passes" / "march.py"
    source = "import moderngl.x\nfrom ...stage import reader\nfrom ... import scene, vdb\n"
    source += "def f():\n    from previs.api import open\n"
    assert own_parts(path, source) == {"stage", "scene", "vdb", "api"}
    assert ("moderngl", "x") in imports(path, source)
    assert own_parts(
        PACKAGE / "scene" / "scene.py", "from .. import vdb\nfrom ..stage.field import x\nimport previs"
    ) == {
        "vdb",
        "stage",
        "__init__",
    }


def test_only_the_window_needs_a_window():
    """Rendering works on machines without the libraries of a desktop."""
    program = (
        "import sys, previs, previs.cli; previs.cli.build_parser();"
        "import previs.commands.view, previs.ui.window, previs.ui.document, previs.ui.picture;"
        "print(sorted({'imgui_bundle', 'glfw'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_modules_are_small():
    long = {str(p.relative_to(ROOT)) for p in SOURCES if len(p.read_text(encoding="utf-8").splitlines()) > LINE_LIMIT}
    assert long == set(LONG_MODULES)


def tracked() -> list[Path]:
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listing.returncode != 0:
        pytest.skip("not a git checkout")
    return [path for name in listing.stdout.split("\0") if name and (path := ROOT / name).is_file()]


def test_no_drawer_for_odds_and_ends():
    names = {"utils", "util", "misc", "helpers", "common"}
    assert not [p for p in tracked() if p.stem in names]


def test_files_do_not_name_the_machine_they_were_written_on():
    # Put together here, so that this file does not name them either.
    forbidden = [folder.encode() for folder in ("/" + "work/", "../" + "shared", "/" + "root/")]
    offenders = [
        f"{path.relative_to(ROOT)}: {text.decode()}"
        for path in tracked()
        if path.relative_to(ROOT).parts[0] != ".ci"
        for text in forbidden
        if text in path.read_bytes()
    ]
    assert not offenders


def test_the_public_names_exist_and_are_documented():
    import previs

    for name in previs.__all__:
        assert getattr(previs, name).__doc__
