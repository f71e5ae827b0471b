"""Options of exports that cannot be, what a format cannot hold, and the command."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import handeye_fg as hf
from example_results import make_result
from export_readers import EXACT, matrix_of, of_command, of_urdf
from handeye_fg.cli import main
from handeye_fg.findings import FreeDirection
from handeye_fg.frames import inverse
from handeye_fg.io.exports import export_text
from handeye_fg.types import CameraModel


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gripper_frame": ""}, "'' is no name of a frame"),
        ({"camera_frame": "a b"}, "'a b' is no name of a frame"),
        ({"base_frame": "$(rm -rf /)"}, "is no name of a frame"),
        ({"camera_frame": 'x"/><evil'}, "is no name of a frame"),
        ({"camera_link": "a\nb"}, "is no name of a frame"),
        ({"link_to_optical": (0.0, 0.0, 0.0)}, "no name of the body"),
        ({"camera_link": "c", "link_to_optical": (0.0, 1.0)}, "is 0.0 1.0, but must be X Y Z"),
        ({"camera_link": "c", "link_to_optical": (0.0,) * 7}, "with a unit quaternion"),
        ({"camera_link": "c", "link_to_optical": (np.nan,) * 3}, "is nan nan nan, but must"),
        ({"camera": "cam0"}, "there is one camera, without a name, but 'cam0' is asked for"),
    ],
)
def test_options_that_cannot_be(options: dict[str, Any], message: str) -> None:
    with pytest.raises(hf.InputDataError, match=message.replace("(", r"\(").replace("$", r"\$")):
        export_text(make_result(), "ros2", hf.ExportOptions(**options))


def test_what_a_format_cannot_hold_is_refused() -> None:
    bare = make_result(camera=None, intrinsics_std=None, sfm=None)
    with pytest.raises(hf.InputDataError, match="no intrinsics"):
        export_text(bare, "nerfstudio")
    assert "camera_matrix" not in export_text(bare, "opencv")
    with pytest.raises(hf.InputDataError, match="no camera poses"):
        export_text(make_result(images=()), "tum")
    rational = CameraModel(model="FULL_OPENCV", width=9, height=9, params=np.ones(12))
    with pytest.raises(hf.InputDataError, match="terms k4, k5 and k6 of FULL_OPENCV"):
        export_text(
            make_result(camera=rational, intrinsics_std=np.ones(12), intrinsics_correlation=None),
            "nerfstudio",
        )
    for export in (hf.export, export_text):
        with pytest.raises(hf.InputDataError, match="there is no format 'cad'"):
            export(make_result(), "cad")
    with pytest.raises(hf.InputDataError, match="colmap is a folder"):
        hf.export(make_result(), "colmap")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = make_result()
    result.save(tmp_path)
    flags = ["export", str(tmp_path), "--format", "urdf", "--gripper-frame", "tool0"]
    assert (
        main([*flags, "--camera-link", "camera_link", "--link-to-optical", "0", "-0.1", "0"]) == 0
    )
    printed = capsys.readouterr()
    assert printed.err == ""
    offset = matrix_of((0.0, -0.1, 0.0), (-0.5, 0.5, -0.5, 0.5))
    np.testing.assert_allclose(of_urdf(printed.out)[0], result.matrix @ inverse(offset), **EXACT)
    assert main([*flags, "--output", str(tmp_path / "deep" / "arm.urdf")]) == 0
    assert of_urdf((tmp_path / "deep" / "arm.urdf").read_text())[1] == "tool0"
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "arm.urdf" in printed.err
    assert main(["export", str(tmp_path / "nowhere"), "--format", "ros2"]) == 2
    assert main(["export", str(tmp_path), "--format", "cad"]) == 2
    assert main(["export", str(tmp_path), "--format", "colmap"]) == 2
    capsys.readouterr()
    free = FreeDirection(
        kind="rotation", vector=np.array([0.0, 0.0, 1.0]), frame="gripper", description="Turn it."
    )
    replace(result, status="partial", free_directions=(free,)).save(tmp_path)
    assert main(["export", str(tmp_path), "--format", "ros2"]) == 3
    assert "PARTIAL" in capsys.readouterr().err


def test_the_command_needs_no_gtsam(tmp_path: Path) -> None:
    make_result().save(tmp_path)
    code = (
        "import sys; sys.modules['gtsam'] = sys.modules['pycolmap'] = None\n"
        f"from handeye_fg.cli import main; sys.exit(main(['export', {str(tmp_path)!r}, '--format', 'ros1']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert of_command(done.stdout)[1] == "gripper"
