"""The notebooks run from beginning to end; real data sets are left out, and random draws are few."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.e2e
@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(notebook: Path, tmp_path: Path) -> None:
    settings = tmp_path / "pytest.ini"  # its own: nbmake's plugin is not under this project's rules
    settings.write_text("[pytest]\n", encoding="utf-8")
    environment = {k: v for k, v in os.environ.items() if k != "HANDEYE_FG_REAL_DATA"}
    environment["HANDEYE_FG_DRAWS"] = "4"
    command = [
        *(sys.executable, "-m", "pytest", "--nbmake", "--nbmake-timeout=600", "-q"),
        *("-c", str(settings), "-p", "no:cacheprovider", str(notebook)),
    ]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_are_stored(notebook: Path) -> None:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not [output for output in outputs if output["output_type"] == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]
