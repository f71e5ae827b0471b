"""Images that had no part in the calibration, and how robot and X predict them."""

import json
import shutil
from dataclasses import replace

import cv2
import jsonschema
import numpy as np
import pycolmap
import pytest
from scipy import stats

import handeye_fg as hf
from handeye_fg import cli, frames, sfm
from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.graph import NewImages, predicted
from handeye_fg.inputs import read_model_inputs
from handeye_fg.io.results import result_schema, to_document
from handeye_fg.parts import only
from handeye_fg.pipeline import solve_scene
from handeye_fg.progress import Stopwatch, silent
from handeye_fg.scene import Scene
from handeye_fg.simulate import simulate_rig, simulate_scene
from handeye_fg.simulate.scenes import disturbed
from handeye_fg.types import Rig
from tabletop import HALF_CAMERA, NAMES, TABLETOP, save_halves

N_OLD, N_NEW = 12, 4


def held_out(seed, arm_deg, *, static=False, spoilt=0.0, n_cameras=1):
    """A calibration from twelve poses, and what it says of four more."""
    noise = {
        "n_points": 60,
        "start_sigma": 1e-4,
        "robot_rotation_sigma": np.deg2rad(arm_deg),
        "robot_translation_sigma": 1e-2 * arm_deg,
    }
    rng = np.random.default_rng(seed)
    if n_cameras == 1:
        scene = simulate_scene(rng, n_images=N_OLD + N_NEW, **noise)
        rig, robot = Rig.of_one_camera(N_OLD + N_NEW), scene.robot_poses
    else:  # at the first of the new poses with an image of the first camera only
        several = simulate_rig(
            rng,
            n_cameras=n_cameras,
            n_poses=N_OLD + N_NEW,
            missing=frozenset({(1, N_OLD)}),
            **noise,
        )
        scene, rig, robot = several.scene, several.rig, several.robot_poses
    given = reported = robot.base_T_gripper
    if static:  # the scene of a base in a gripper
        given = disturbed(
            np.random.default_rng([1, seed]),
            frames.inverse(scene.base_T_gripper),
            scene.noise.robot_rotation,
            scene.noise.robot_translation,
        )
        reported = frames.inverse(given)
    if spoilt:
        wrong = frames.exp([spoilt, 0.0, 0.0, 0.0, spoilt, 0.0])
        new = frames.inverse(reported[N_OLD:]) if static else reported[N_OLD:]
        new = frames.inverse(new @ wrong) if static else new @ wrong
        reported = np.concatenate([reported[:N_OLD], new])
    later = rig.pose >= N_OLD
    number_of_new = np.cumsum(later) - 1
    old = only(
        scene.model, [name for name, new in zip(scene.model.names, later, strict=True) if not new]
    )
    # A point's number in the model of the old images, as far as two of them show it.
    twice = np.bincount(old.tracks.point_index, minlength=len(scene.points_world)) >= 2
    kept, number = twice[old.tracks.point_index], np.cumsum(twice) - 1
    tracks = replace(
        old.tracks,
        points_world=old.tracks.points_world[twice],
        image_index=old.tracks.image_index[kept],
        point_index=number[old.tracks.point_index[kept]],
        pixels=old.tracks.pixels[kept],
    )
    options = hf.Options(
        setup="eye-to-hand" if static else "eye-in-hand",
        graph=hf.GraphOptions(intrinsics="fixed"),
    )
    poses = dict(zip(robot.names[:N_OLD], given[:N_OLD], strict=True))
    inputs, model = read_model_inputs(replace(old, tracks=tracks), poses, options)
    found = []

    def prove(_, view, arm, *__):
        final = view.refinement
        refined = dict(zip(map(tuple, final.tracks.pixels), final.tracks.point_index, strict=True))
        of_old = {
            point: refined[tuple(pixels)]
            for point, pixels in zip(tracks.point_index.tolist(), tracks.pixels, strict=True)
            if tuple(pixels) in refined
        }
        every = scene.model.tracks
        new = [
            (number_of_new[image], of_old[number[point]], pixels)
            for image, point, pixels in zip(
                every.image_index.tolist(), every.point_index.tolist(), every.pixels, strict=True
            )
            if later[image] and twice[point] and number[point] in of_old
        ]
        image_index, point_index, pixels = map(np.array, zip(*new, strict=True))
        images = NewImages(
            base_T_gripper=reported[N_OLD:],
            rig=replace(rig, camera=rig.camera[later], pose=rig.pose[later] - N_OLD),
            image_index=image_index,
            point_index=point_index,
            pixels=pixels,
        )
        found.append(predicted(images, arm, final, view.beliefs, inverted=static))

    solve_scene(Scene(model=model), inputs, options, Stopwatch(), silent, prove)
    return found[0]


def ratio(found):
    """Root mean squares of errors in rotation and translation over those expected."""
    lengths = np.linalg.norm(found.errors.reshape(-1, 2, 3), axis=2)
    return np.sqrt(np.mean(lengths**2, axis=0)) / found.expected


@pytest.mark.parametrize(("static", "n_cameras"), [(False, 1), (True, 1), (False, 2)])
def test_wrong_new_poses_are_found(static, n_cameras):
    right = held_out(1, 0.03, static=static, n_cameras=n_cameras)
    wrong = held_out(1, 0.03, static=static, spoilt=0.01, n_cameras=n_cameras)
    assert right.probability > 1e-3
    assert wrong.probability < 1e-6
    assert right.within > 0.8
    assert wrong.within < 0.3
    # Turned by 0.01 about x and shifted by 10 mm along y, in the gripper's axes.
    np.testing.assert_allclose(
        wrong.errors - right.errors, [[-0.01, 0, 0, 0, -0.01, 0]] * N_NEW, atol=2e-4
    )


def test_static_camera():
    found = held_out(2, 0.03, static=True)
    assert found.probability > 1e-3
    assert (ratio(found) < 1.7).all()
    assert found.within > 0.8


@pytest.mark.slow
@pytest.mark.simulation
@pytest.mark.parametrize("n_cameras", [1, 2])
def test_errors_are_as_large_as_expected(n_cameras):
    found = [held_out(seed, 0.03, n_cameras=n_cameras) for seed in range(12)]
    assert stats.kstest([one.probability for one in found], "uniform").pvalue > 1e-3
    # 12 runs of 12 components: standard error of a root mean square 6 %.
    both = np.sqrt(np.mean([ratio(one) ** 2 for one in found], axis=0))
    assert ((both > 0.75) & (both < 1.3)).all()
    pixels = [np.mean(one.reprojection_rms**2 / one.expected_reprojection**2) for one in found]
    assert 0.75 < np.sqrt(np.mean(pixels)) < 1.3
    assert 0.88 < np.mean([one.within for one in found]) < 0.99


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Half-size images of the table, ten old ones and two new ones."""
    folder = tmp_path_factory.mktemp("halved")
    (folder / "old").mkdir()
    (folder / "new").mkdir()
    save_halves(folder / "old", 12)
    for i in (4, 9):
        (folder / "old" / NAMES[i]).rename(folder / "new" / NAMES[i])
    return folder


@pytest.mark.e2e
@pytest.mark.slow
def test_new_images_of_the_table(folder, tmp_path):
    options = hf.Options(sfm=hf.SfmOptions(preset="fast"))
    poses = TABLETOP / "poses.csv"
    given = {"camera": HALF_CAMERA, "options": options, "output": tmp_path}
    plain = hf.calibrate(folder / "old", poses, **given)
    result = hf.calibrate(folder / "old", poses, holdout=(folder / "new", poses), **given)
    np.testing.assert_array_equal(result.matrix, plain.matrix)
    np.testing.assert_array_equal(result.covariance, plain.covariance)
    assert "of 2 new images" in result.message
    proof = result.holdout
    assert proof.new_images
    assert len(proof.images) == 2
    assert proof.probability > 1e-3
    assert proof.reprojection_rms < 2.0 * proof.expected_reprojection
    document = to_document(result)
    jsonschema.Draft202012Validator(result_schema()).validate(document)
    result.save(tmp_path)
    again = hf.load_result(tmp_path).holdout
    assert again.new_images
    assert again.reprojection_rms == pytest.approx(proof.reprojection_rms)
    assert json.dumps(document["holdout"])

    # With the model that was made, and its database, as with the images.
    model = tmp_path / "sfm"
    again = hf.refine(model, poses, options, holdout=(folder / "new", poses)).holdout
    assert [one.name for one in again.images] == [one.name for one in proof.images]
    assert again.reprojection_rms == pytest.approx(proof.reprojection_rms, rel=0.2)
    assert again.probability > 1e-3
    with pytest.raises(InputDataError, match="given as a value"):
        hf.refine(sfm.read_model(model), poses, options, holdout=(folder / "new", poses))
    with pytest.raises(InputDataError, match="camera poses without points"):
        hf.refine(sfm.read_model_poses(model), poses, options, holdout=(folder / "new", poses))
    bare = tmp_path / "bare" / "below" / "sparse" / "0"
    shutil.copytree(model, bare, ignore=shutil.ignore_patterns("database.db"))
    with pytest.raises(InputDataError, match=r"there is no database\.db in or above"):
        hf.refine(bare, poses, options, holdout=(folder / "new", poses))
    beside = bare.parents[1] / "database.db"  # that of the project
    beside.write_bytes(b"no database")
    with pytest.raises(InputDataError, match=r"below/database\.db: cannot be read"):
        hf.refine(bare, poses, options, holdout=(folder / "new", poses))
    shutil.copyfile(model / "database.db", beside)
    with pycolmap.Database.open(beside) as db:
        image = db.read_all_images()[0]
        image.name = "other.jpg"
        db.update_image(image)
    with pytest.raises(InputDataError, match=r"has no image frame_\d+.jpg of the model"):
        hf.refine(bare, poses, options, holdout=(folder / "new", poses))

    # Images that show something else, and of another size.
    (tmp_path / "other").mkdir()
    noise = np.random.default_rng(0).integers(0, 256, (480, 640), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "other" / "frame_0000.jpg"), noise)
    with pytest.raises(ReconstructionError, match="none of the 1 new images"):
        hf.calibrate(folder / "old", poses, holdout=(tmp_path / "other", poses), **given)
    with pytest.raises(InputDataError, match="1280x960 pixels, but those of the calibration"):
        hf.calibrate(folder / "old", poses, holdout=(TABLETOP / "images", poses), **given)
    with pytest.raises(InputDataError, match="no pose has the name of an image"):
        hf.calibrate(folder / "old", poses, holdout=(folder / "new", {"x.png": np.eye(4)}), **given)


@pytest.mark.e2e
@pytest.mark.slow
def test_new_images_of_several_cameras(folder, tmp_path):
    """The table's images as those of two cameras, which are one: every other one is the second's."""
    known = hf.read_poses(TABLETOP / "poses.csv")
    poses = {}
    for kind in ("old", "new"):
        names = sorted(path.name for path in (folder / kind).iterdir())
        for i, name in enumerate(names):
            place = f"cam{i % 2}/{name}"
            (tmp_path / kind / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / kind / name, tmp_path / kind / place)
            poses[place] = known.base_T_gripper[known.names.index(name)]
    options = hf.Options(sfm=hf.SfmOptions(preset="fast"))
    given = {"camera": HALF_CAMERA, "options": options, "output": tmp_path / "out"}
    result = hf.calibrate(tmp_path / "old", poses, holdout=(tmp_path / "new", poses), **given)
    assert len(result.cameras) == 2
    assert "were left out" not in result.message  # the poses of new images stand among the others
    proof = result.holdout
    assert [one.name.partition("/")[0] for one in proof.images] == ["cam0", "cam1"]
    assert proof.probability > 1e-3
    assert proof.reprojection_rms < 2.0 * proof.expected_reprojection
    # A wrong pose of the second camera's image is found, and is that image's error.
    wrong = {
        name: pose @ frames.exp([0.01 * name.startswith("cam1"), 0, 0, 0, 0, 0])
        for name, pose in poses.items()
    }
    model = tmp_path / "out" / "sfm"
    right, spoilt = (
        hf.refine(model, poses, options, holdout=(tmp_path / "new", new)).holdout
        for new in (poses, wrong)
    )
    assert right.probability > 1e-3
    assert spoilt.probability < 1e-6
    assert spoilt.images[0].rotation == pytest.approx(right.images[0].rotation, rel=1e-6)
    assert spoilt.images[1].rotation > right.images[1].rotation + 0.003
    with pytest.raises(InputDataError, match="some lie in no sub-folder, but the calibration has"):
        hf.refine(model, poses, options, holdout=(folder / "new", TABLETOP / "poses.csv"))


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--holdout-images", "new"], "belong together"),
        (
            ["--holdout-images", "new", "--holdout-poses", "p", "--holdout", "0.2"],
            "use one of them",
        ),
        (
            ["--holdout-images", "new", "--holdout-poses", "p", "--model", "m"],
            "COLMAP model m: no such folder",
        ),
    ],
)
def test_command_refuses(tmp_path, capsys, flags, words):
    arguments = ["calibrate", "-", "poses.csv", "--output", str(tmp_path), *flags]
    assert cli.main(arguments) == 2
    assert words in " ".join(capsys.readouterr().err.split())
