import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    "README.md",
    "benchmarks/README.md",
    *(f"docs/{page.name}" for page in sorted((ROOT / "docs").glob("*.md"))),
]


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_import_contracts_hold() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as main; main()"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


@pytest.mark.parametrize(
    ("blocked", "imported"),
    [
        ("pycolmap", "handeye_fg.solvers"),
        ("pycolmap", "handeye_fg.graph"),
        ("pycolmap", "handeye_fg.io"),
        ("pycolmap", "handeye_fg.report"),
        ("pycolmap", "handeye_fg.cli"),
        ("gtsam", "handeye_fg.solvers"),
        ("handeye_fg", "factors"),
    ],
)
def test_imports_without(blocked: str, imported: str) -> None:
    """The package and all its modules load where the other is missing."""
    done = run_python(
        f"import sys; sys.modules[{blocked!r}] = None\n"
        f"import importlib, pkgutil\n"
        f"package = importlib.import_module({imported!r})\n"
        "for module in pkgutil.iter_modules(getattr(package, '__path__', [])):\n"
        "    importlib.import_module(f'{package.__name__}.{module.name}')\n"
    )
    assert done.returncode == 0, done.stderr


def test_the_block_blocks() -> None:
    done = run_python("import sys; sys.modules['numpy'] = None; import factors")
    assert done.returncode != 0
    assert "numpy" in done.stderr


def test_help_imports_nothing_heavy() -> None:
    done = run_python(
        "import sys; from handeye_fg.cli import main; main(['--help'])\n"
        "heavy = {'gtsam', 'pycolmap', 'matplotlib', 'scipy', 'cv2', 'pandas'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("package", ["handeye_fg", "factors"])
def test_packages_are_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").is_file()


def test_readme_names_targets_that_exist() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = set(re.findall(r"\bmake ([a-z]+)`?", readme.replace("\n", " \n")))
    assert {"demo", "test"} <= named
    assert named <= set(re.findall(r"^([a-z]+):", makefile, flags=re.MULTILINE))


@pytest.mark.parametrize("page", PAGES)
def test_examples_on_pages_compile(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    for example in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        compile(example, page, "exec")


@pytest.mark.parametrize("page", PAGES)
def test_links_on_pages_lead_somewhere(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)]+)\)", text):
        if "://" in target:
            continue
        file, _, anchor = target.partition("#")
        linked = ROOT / page if not file else (ROOT / page).parent / file
        assert linked.exists(), target
        if anchor:
            titles = re.findall(r"(?m)^#+ (.*)$", linked.read_text(encoding="utf-8"))
            anchors = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}
            assert anchor in anchors, target


def test_nothing_names_a_package_registry() -> None:
    tracked = [ROOT / "Makefile", ROOT / ".ci" / "run", ROOT / "pyproject.toml"]
    for path in tracked:
        text = path.read_text(encoding="utf-8")
        assert "://" not in text
        assert "index-url" not in text
