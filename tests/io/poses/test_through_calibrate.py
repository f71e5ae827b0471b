"""Pose files of other formats as inputs of a calibration from images."""

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg.cli import _parse
from handeye_fg.errors import InputDataError
from handeye_fg.inputs import read_inputs
from handeye_fg.io.poses import read_poses, write_poses
from handeye_fg.options import Options, PoseFileOptions
from handeye_fg.progress import silent
from tabletop import TABLETOP


def inputs_of(path, options):
    return read_inputs(TABLETOP / "images", path, TABLETOP / "camera.yaml", None, options, silent)


@pytest.mark.parametrize(
    "options",
    [
        PoseFileOptions(format="ur", units="mm"),
        PoseFileOptions(format="kitti", pair_by="number"),
    ],
)
def test_inputs_are_those_of_the_contract_file(tmp_path, options):
    write_poses(read_poses(TABLETOP / "poses.csv"), tmp_path / "poses", options)
    inputs = inputs_of(tmp_path / "poses", Options(poses=options))
    expected = inputs_of(TABLETOP / "poses.csv", Options())
    assert inputs.names == expected.names
    assert inputs.left_out == ()
    names = expected.names
    np.testing.assert_allclose(
        inputs.robot_poses(names), expected.robot_poses(names), rtol=0.0, atol=1e-12
    )


def test_rows_without_names_are_not_paired_unasked(tmp_path):
    path = tmp_path / "poses.txt"
    write_poses(read_poses(TABLETOP / "poses.csv"), path, PoseFileOptions(format="kitti"))
    with pytest.raises(InputDataError, match=r"its rows have no image names; .*--pair-by"):
        inputs_of(path, Options())


def test_flags_become_options():
    flags = [
        "--pose-format",
        "kuka",
        "--units",
        "m",
        "--angles",
        "rad",
        "--rotation",
        "ZYZ",
        "--inverted",
    ]
    more = ["--pair-by", "nearest-time", "--time-tolerance-s", "0.5"]
    command = _parse(["calibrate", "images", "poses", *flags, *more])
    assert command.options.poses == PoseFileOptions(
        format="kuka",
        units="m",
        angles="rad",
        rotation="ZYZ",
        inverted=True,
        pair_by="nearest-time",
        time_tolerance_s=0.5,
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("format", "cuka"),
        ("units", "cm"),
        ("angles", "grad"),
        ("rotation", "xYz"),
        ("pair_by", "chance"),
        ("time_tolerance_s", 0.0),
    ],
)
def test_values_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"{name} is {value!r}, but must be"):
        PoseFileOptions(**{name: value})
    with pytest.raises(InputDataError, match=f"{name} is {value!r}, but must be"):
        hf.read_poses("poses.csv", **{name: value})
