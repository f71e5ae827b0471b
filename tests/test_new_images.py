"""Images that had no part in the calibration, and how robot and X predict them."""

import json
from dataclasses import replace

import cv2
import jsonschema
import numpy as np
import pytest
from scipy import stats

import handeye_fg as hf
from handeye_fg import cli, frames
from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.graph import NewImages, predicted
from handeye_fg.inputs import read_model_inputs
from handeye_fg.io.results import result_schema, to_document
from handeye_fg.parts import only
from handeye_fg.pipeline import solve_scene
from handeye_fg.progress import Stopwatch, silent
from handeye_fg.scene import Scene
from handeye_fg.simulate import simulate_scene
from handeye_fg.simulate.scenes import disturbed
from tabletop import HALF_CAMERA, NAMES, TABLETOP, save_halves

N_OLD, N_NEW = 12, 4


def held_out(seed, arm_deg, *, static=False, spoilt=0.0):
    """A calibration from twelve images, and what it says of four more."""
    scene = simulate_scene(
        np.random.default_rng(seed),
        n_images=N_OLD + N_NEW,
        n_points=60,
        start_sigma=1e-4,
        robot_rotation_sigma=np.deg2rad(arm_deg),
        robot_translation_sigma=1e-2 * arm_deg,
    )
    given = reported = scene.robot_poses.base_T_gripper
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
    old = only(scene.model, scene.model.names[:N_OLD])
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
    poses = dict(zip(old.names, given[:N_OLD], strict=True))
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
            (image - N_OLD, of_old[number[point]], pixels)
            for image, point, pixels in zip(
                every.image_index.tolist(), every.point_index.tolist(), every.pixels, strict=True
            )
            if image >= N_OLD and twice[point] and number[point] in of_old
        ]
        image_index, point_index, pixels = map(np.array, zip(*new, strict=True))
        images = NewImages(
            base_T_gripper=reported[N_OLD:],
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


@pytest.mark.parametrize("static", [False, True])
def test_wrong_new_poses_are_found(static):
    right = held_out(1, 0.03, static=static)
    wrong = held_out(1, 0.03, static=static, spoilt=0.01)
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
def test_errors_are_as_large_as_expected():
    found = [held_out(seed, 0.03) for seed in range(12)]
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
            "cannot be used with",
        ),
    ],
)
def test_command_refuses(tmp_path, capsys, flags, words):
    arguments = ["calibrate", "images", "poses.csv", "--output", str(tmp_path), *flags]
    assert cli.main(arguments) == 2
    assert words in " ".join(capsys.readouterr().err.split())
