"""Plans for simulated calibrations, in Python and on the command line."""

import json
from dataclasses import replace

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg import cli, frames
from handeye_fg.errors import InputDataError
from handeye_fg.findings import RobotErrors
from handeye_fg.io.config import write_config
from handeye_fg.planning import Workspace, plan, plan_first
from handeye_fg.planning.candidates import candidates
from handeye_fg.planning.expected import corrected, of_result
from handeye_fg.planning.next_poses import _expected
from handeye_fg.planning.situation import situation_of
from handeye_fg.sfm import read_model
from handeye_fg.simulate import simulate_rig, simulate_scene
from handeye_fg.simulate.scenes import SCENE_CENTRE
from handeye_fg.synthetic_set import write_scene

WIDE = Workspace((0.0, -0.6, 0.0), (1.0, 0.6, 0.9))


def calibrated(folder, motion="general", n_images=8, **options):
    """A folder as ``calibrate`` leaves it."""
    scene = simulate_scene(
        np.random.default_rng(3), n_images=n_images, n_points=80, motion=motion, start_sigma=1e-4
    )
    write_scene(scene, folder)
    (folder / "model").rename(folder / "sfm")
    chosen = hf.Options(graph=hf.GraphOptions(intrinsics="fixed"), **options)
    result = hf.refine(folder / "sfm", folder / "poses.csv", chosen)
    result.save(folder)
    write_config(chosen, folder / "config.toml")
    return result


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("general")
    calibrated(folder)
    return folder


def test_each_pose_makes_x_more_certain(folder):
    found = plan(folder, count=4, reach=WIDE)
    result = hf.load_result(folder)
    assert found.names == tuple(f"next_{k:03d}.jpg" for k in range(1, 5))
    assert WIDE.reachable(found.base_T_gripper).all()
    assert found.present.std_translation_mm == of_result(result).std_translation_mm
    worst = [max(one.std_translation_mm) for one in (found.present, *found.expected)]
    assert worst == sorted(worst, reverse=True)
    assert worst[-1] < 0.7 * worst[0]
    assert f"{worst[-1]:.2g} mm" in found.message
    # Distinct from those taken and from each other.
    taken = np.array([image.base_T_camera for image in result.images])
    taken = taken @ frames.inverse(result.matrix)
    every = np.concatenate([found.base_T_gripper, taken])
    distance = np.linalg.norm(every[:, None, :3, 3] - every[None, :, :3, 3], axis=2)
    assert distance[np.triu_indices(len(every), 1)].min() > 1e-3
    again = plan(result, read_model(folder / "sfm"), 4, reach=WIDE)
    np.testing.assert_array_equal(found.base_T_gripper, again.base_T_gripper)


def test_the_workspace_is_where_the_gripper_was(folder):
    result = hf.load_result(folder)
    taken = np.array([image.base_T_camera for image in result.images])
    taken = taken @ frames.inverse(result.matrix)
    # The refined cameras are a little off the reconstruction's.
    box = taken[:, :3, 3].min(axis=0) - 2e-3, taken[:, :3, 3].max(axis=0) + 2e-3
    inside = Workspace(*(tuple(corner) for corner in box))
    assert inside.reachable(plan(folder, count=3).base_T_gripper).all()
    with pytest.raises(InputDataError, match="none of 20000 poses"):
        plan(folder, reach=Workspace((5.0, 5.0, 5.0), (6.0, 6.0, 6.0)))


def test_free_directions_are_what_is_planned_for(tmp_path):
    result = calibrated(tmp_path, "one_axis")
    assert result.status == "partial"
    found = plan(tmp_path, count=2, reach=WIDE)
    assert found.present.worst[1] is None
    assert "is not determined: all rotations share one axis" in found.message
    assert "of the poses nothing is left undetermined" in found.message
    assert not found.expected[-1].free_directions
    assert None not in found.expected[-1].std_translation_mm
    # The user's measure of the height, in config.toml, leaves nothing free.
    axis = tuple(float(x) for x in result.free_directions[0].vector)
    prior = hf.Prior("translation-along", axis, float(result.matrix[:3, 3] @ axis), 1e-3)
    other = tmp_path / "known"
    assert calibrated(other, "one_axis", priors=(prior,)).status == "ok"
    assert not plan(other, count=1, reach=WIDE).present.free_directions


def test_static_camera(tmp_path):
    """The scene of ``simulate_scene`` is that of a base in a gripper, with the robot poses inverted."""
    scene = simulate_scene(np.random.default_rng(4), n_images=8, n_points=80, start_sigma=1e-4)
    reported = frames.inverse(scene.robot_poses.base_T_gripper)
    write_scene(
        replace(scene, robot_poses=replace(scene.robot_poses, base_T_gripper=reported)), tmp_path
    )
    options = hf.Options(setup="eye-to-hand", graph=hf.GraphOptions(intrinsics="fixed"))
    result = hf.refine(tmp_path / "model", tmp_path / "poses.csv", options)
    found = plan(result, tmp_path / "model", 2, reach=Workspace((-9.0,) * 3, (9.0,) * 3))
    worst = [max(one.std_translation_mm) for one in (found.present, *found.expected)]
    assert worst == sorted(worst, reverse=True)
    # The object on the gripper stays in the camera's view.
    centre = frames.inverse(result.matrix) @ found.base_T_gripper @ [*SCENE_CENTRE, 1.0]
    assert (centre[:, 2] > 0.2).all()
    assert (np.abs(centre[:, :2]).max(axis=1) < 0.7 * centre[:, 2]).all()


def test_several_cameras():
    """The plan is for the camera that is least certain, and knows which images share a robot pose."""
    rig = simulate_rig(
        np.random.default_rng(5),
        n_poses=8,
        n_points=80,
        start_sigma=1e-4,
        missing=frozenset((1, i) for i in range(5, 8)),
    )
    options = hf.Options(graph=hf.GraphOptions(intrinsics="fixed"))
    result = hf.refine(rig.scene.model, rig.robot_poses, options)
    there = situation_of(np.random.default_rng(0), result, rig.scene.model)
    np.testing.assert_array_equal(there.rig.camera, rig.rig.camera)
    np.testing.assert_array_equal(there.rig.pose, rig.rig.pose)
    np.testing.assert_allclose(there.taken, rig.robot_poses.base_T_gripper, atol=1e-3)
    found = plan(result, rig.scene.model, 3, reach=WIDE)
    assert found.camera == "cam1"
    assert "of cam1, the least certain of the cameras" in found.message
    assert found.names[0] == "next_001.jpg"
    assert found.present.std_translation_mm == of_result(result.cameras[1]).std_translation_mm
    worst = [max(one.std_translation_mm) for one in (found.present, *found.expected)]
    assert worst == sorted(worst, reverse=True)
    assert worst[-1] < 0.8 * worst[0]
    # What the model expects of the images that are there is what the refinement reports of them.
    options = candidates(np.random.default_rng(0), there.cameras, WIDE, 8, 1)
    for one, expected in zip(result.cameras, _expected(there, options, np.arange(0)), strict=True):
        reported = of_result(one)
        for name in ("std_rotation_deg", "std_translation_mm"):
            np.testing.assert_allclose(getattr(expected, name), getattr(reported, name), rtol=0.3)


def test_poses_that_were_kept_out_can_be_used(tmp_path, capsys):
    whole = calibrated(tmp_path / "whole", n_images=12)
    held = calibrated(tmp_path / "held", n_images=12, holdout=0.34)
    found = plan(tmp_path / "held", count=2, reach=WIDE)
    assert found.kept_out.count == 4
    assert found.present.std_translation_mm == of_result(held).std_translation_mm
    # Without any new image: what a calibration from all of them reports, but for the levels of noise that it finds.
    levels = whole.noise.robot_translation / held.noise.robot_translation
    used, unused = found.kept_out.used, found.kept_out.unused
    expected = levels * np.array(used.std_translation_mm)
    np.testing.assert_allclose(expected, of_result(whole).std_translation_mm, rtol=0.25)
    worst = [one.worst[1] for one in (found.present, used, *found.expected)]
    assert worst == sorted(worst, reverse=True)
    assert found.expected[-1].worst[1] < unused.worst[1] < found.present.worst[1]
    assert "the 4 robot poses that --holdout kept out of X: their images are there" in found.message
    # None of them is proposed again, and new images of a proof are none of the reconstruction's.
    there = situation_of(np.random.default_rng(0), held, read_model(tmp_path / "held" / "sfm"))
    names = [image.name for image in held.holdout.images]
    assert names == [held.images[i].name for i in np.flatnonzero(there.kept_out)]
    assert len(there.taken) == 12
    proof = replace(held, holdout=replace(held.holdout, new_images=True))
    for none in (proof, whole):
        there = situation_of(np.random.default_rng(0), none, read_model(tmp_path / "held" / "sfm"))
        assert not there.kept_out.any()
    flags = ["--count", "1", "--workspace", "0", "-0.6", "0", "1", "0.6", "0.9", "--json"]
    assert cli.main(["plan", str(tmp_path / "held"), *flags]) == 0
    told = capsys.readouterr()
    assert "with those kept out" in told.err
    assert json.loads(told.out)["kept_out"]["count"] == 4


def test_errors_that_are_not_white_stay(folder):
    result = hf.load_result(folder)
    found = plan(folder, count=1, reach=WIDE)
    robot = RobotErrors(
        white=False,
        probability=1e-4,
        resampled_ratio=1.0,
        hidden_rotation=1e-4,
        hidden_translation=1e-4,
        reason="",
    )
    structured = replace(
        result,
        covariance=4.0 * result.covariance,
        certainty=replace(result.certainty, robot=robot),
    )
    now = of_result(result)
    later = corrected(of_result(structured), now, found.expected[0], white=False)
    expected = np.sqrt(
        np.square(found.expected[0].std_translation_mm) + 3.0 * np.square(now.std_translation_mm)
    )
    np.testing.assert_allclose(later.std_translation_mm, expected)


def test_a_first_set():
    found = plan_first(SCENE_CENTRE, 0.45, WIDE, 10)
    assert len(found.names) == 10
    assert found.present is None
    assert found.expected[-1].worst[1] < 0.5
    camera = found.base_T_gripper
    # The camera looks at the middle of the scene from about the standoff.
    depth = np.einsum("ni,ni->n", SCENE_CENTRE - camera[:, :3, 3], camera[:, :3, 2])
    assert ((depth > 0.26) & (depth < 0.7)).all()
    assert np.ptp(depth) > 0.2
    with pytest.raises(ValueError, match="3 or more"):
        plan_first(SCENE_CENTRE, 0.45, WIDE, 2)


def test_what_has_no_images_is_refused(folder):
    result = hf.load_result(folder)
    model = read_model(folder / "sfm")
    with pytest.raises(InputDataError, match="no images"):
        plan(replace(result, noise=None, certainty=None), model)
    with pytest.raises(InputDataError, match="needs the reconstruction"):
        plan(result)
    others = tuple(replace(image, name=f"other_{image.name}") for image in result.images)
    with pytest.raises(InputDataError, match="do not belong together"):
        plan(replace(result, images=others), model)
    with pytest.raises(ValueError, match="1 or more"):
        plan(result, model, 0)


def test_command(folder, capsys):
    flags = ["--count", "2", "--workspace", "0", "-0.6", "0", "1", "0.6", "0.9", "--json"]
    assert cli.main(["plan", str(folder), *flags]) == 0
    told = capsys.readouterr()
    document = json.loads(told.out)
    written = hf.read_poses(folder / "next_poses.csv")
    assert written.names == ("next_001.jpg", "next_002.jpg")
    np.testing.assert_allclose(
        written.base_T_gripper, [pose["base_T_gripper"] for pose in document["poses"]], atol=1e-9
    )
    assert len(document["expected"]) == 2
    assert "with next_001.jpg" in told.err
    found = plan(folder, count=2, reach=WIDE)
    np.testing.assert_allclose(written.base_T_gripper, found.base_T_gripper, atol=1e-9)


def test_command_for_a_first_set(tmp_path, capsys):
    place = ["--look-at", "0.5", "0", "0", "--standoff", "0.45"]
    box = ["--workspace", "0", "-0.6", "0", "1", "0.6", "0.9"]
    out = tmp_path / "poses.txt"
    flags = [*place, *box, "--count", "4", "--pose-format", "tum", "--output", str(out)]
    assert cli.main(["plan", str(tmp_path), *flags]) == 0
    assert "with all of them" in capsys.readouterr().err
    assert len(out.read_text(encoding="utf-8").splitlines()) >= 4


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ([], "has no result.json"),
        (["--look-at", "0", "0", "0"], "needs both"),
        (["--look-at", "0", "0", "0", "--standoff", "0.4"], "needs --workspace or --urdf"),
        (["--look-at", "0", "0", "0", "--standoff", "-1"], "must be a length"),
        (["--urdf", "robot.urdf"], "belong together"),
        (["--count", "-1"], "1 or more"),
        (["--workspace", "1", "0", "0", "0", "1", "1"], "highest corner"),
    ],
)
def test_command_refuses(tmp_path, capsys, flags, words):
    assert cli.main(["plan", str(tmp_path), *flags]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
