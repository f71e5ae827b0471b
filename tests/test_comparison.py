"""Two results side by side: the probability is that of chance, whatever the frames and the free directions."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from example_results import make_result
from handeye_fg import cli, frames
from handeye_fg.comparison import compare
from handeye_fg.errors import InputDataError
from handeye_fg.findings import FreeDirection
from handeye_fg.graph import start_state
from handeye_fg.io.camera_results import CameraReport
from handeye_fg.observability import on_determined
from handeye_fg.simulate.scenes import default_camera, scene_of, truth_of
from handeye_fg.solvers import linear_start
from refinements import refined_from

X = frames.exp(np.array([0.3, -0.2, 1.4, 0.03, -0.05, 0.09]))
RESULT = make_result(matrix=X, provenance={"input_digest": "a"})
HEIGHT = FreeDirection(
    kind="translation", vector=X[:3, 2], frame="gripper", description="Tilt the camera."
)


def drawn_covariance(rng):
    """Of a usual size, with correlations."""
    root = rng.standard_normal((6, 9)) * np.repeat([2e-4, 1e-3], 3)[:, None]
    return root @ root.T / 9.0


def result(matrix=X, covariance=None, freedom=np.inf, digest="b", **changes):
    covariance = 1e-8 * np.eye(6) if covariance is None else covariance
    return replace(
        RESULT,
        matrix=matrix,
        covariance=covariance,
        observability={"degrees_of_freedom": freedom},
        provenance={"input_digest": digest},
        **changes,
    )


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_the_order_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    first = result(covariance=drawn_covariance(rng), freedom=7.0, digest="a")
    moved = X @ frames.exp(1e-2 * rng.standard_normal(6))
    second = result(moved, drawn_covariance(rng), freedom=40.0)
    there, back = (compare(*pair).differences[0] for pair in ((first, second), (second, first)))
    assert there.probability == pytest.approx(back.probability, rel=1e-6, abs=1e-300)
    assert there.distance == pytest.approx(back.distance, rel=1e-6)
    np.testing.assert_allclose(there.xi, -back.xi, atol=1e-12)


@pytest.mark.parametrize("freedoms", [(np.inf, np.inf), (7.0, 7.0), (10.0, np.inf)])
def test_probabilities_of_chance_are_uniform(freedoms):
    """Draws of t-distributed estimates of one X, as the covariances of results describe them."""
    rng = np.random.default_rng(3)
    true = [drawn_covariance(rng), 4.0 * drawn_covariance(rng)]
    scales = [1.0 if np.isinf(nu) else nu / (nu - 2.0) for nu in freedoms]
    found = []
    for _ in range(400):
        pair = []
        for C, nu, grown, digest in zip(true, freedoms, scales, "ab", strict=True):
            estimated = C * (1.0 if np.isinf(nu) else rng.chisquare(nu) / nu)
            matrix = X @ frames.exp(rng.multivariate_normal(np.zeros(6), C))
            pair.append(result(matrix, grown * estimated, nu, digest))
        item = compare(*pair).differences[0]
        found.append((item.probability, item.probability_rotation, item.probability_translation))
    for probabilities in np.transpose(found):
        assert stats.kstest(probabilities, "uniform").pvalue > 1e-3


def test_what_is_free_in_either_is_not_compared():
    """An error of 30 mm along the camera's axis, which one of the two leaves free, says nothing."""
    rng = np.random.default_rng(4)
    shared, other = drawn_covariance(rng), drawn_covariance(rng)
    vague = shared + np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    partial = {"status": "partial", "free_directions": (HEIGHT,)}
    found = []
    for _ in range(150):
        first = result(
            X
            @ frames.exp(rng.multivariate_normal(np.zeros(6), shared))
            @ frames.exp([0.0] * 5 + [0.03]),
            on_determined(vague),
            digest="a",
            **partial,
        )
        second = result(X @ frames.exp(rng.multivariate_normal(np.zeros(6), other)), other)
        comparison = compare(first, second)
        assert comparison.differences[0].directions == 5
        assert not comparison.complete
        found.append(comparison.probability)
    assert stats.kstest(found, "uniform").pvalue > 1e-3
    assert "Only 5 of the 6 directions" in comparison.message
    assert comparison.differences[0].translation_mm < 10.0


def test_a_camera_that_moved_is_told_with_its_axis():
    comparison = compare(
        result(digest="a"), result(X @ frames.exp([0.0, 0.0, 0.0, 0.0, 1e-3, 0.0]))
    )
    assert comparison.verdict == "differ"
    assert comparison.probability < 1e-6
    assert "position along the camera's y axis, 1 mm, 7.1 standard deviations" in comparison.message
    assert comparison.differences[0].probability_rotation == pytest.approx(1.0)
    assert "same input" not in comparison.message
    digest = {"digest": "a"}
    assert "same input" in compare(result(**digest), result(**digest)).message


def test_without_covariance_nothing_is_judged():
    comparison = compare(result(), replace(RESULT, covariance=None))
    assert (comparison.verdict, comparison.probability) == ("unknown", None)
    assert "no covariance" in comparison.message


def test_several_cameras_by_name():
    def rig(*moved):
        return tuple(
            CameraReport(
                name=f"cam{k}",
                matrix=X @ frames.exp([0.0, 0.0, 0.0, shift, 0.0, 0.0]),
                covariance=1e-8 * np.eye(6),
                free_directions=(),
                camera=RESULT.camera,
                intrinsics_refined=True,
                intrinsics_std=RESULT.intrinsics_std,
                intrinsics_note="",
                pixel=0.3,
                other_intrinsics=None,
                focal_offset=None,
                first_T_camera=np.eye(4),
                first_T_camera_covariance=np.zeros((6, 6)),
            )
            for k, shift in enumerate(moved)
        )

    comparison = compare(result(cameras=rig(0.0, 0.0)), result(cameras=rig(0.0, 1e-3, 0.0)))
    assert [item.camera for item in comparison.differences] == ["cam0", "cam1"]
    assert comparison.verdict == "differ"
    assert "X of cam1 differs by" in comparison.message
    assert comparison.probability == 2.0 * comparison.differences[1].probability
    with pytest.raises(InputDataError, match="no camera in both"):
        compare(result(), result(cameras=rig(0.0)))


def test_different_setups_are_refused():
    with pytest.raises(InputDataError, match="one setup"):
        compare(result(), result(setup="eye-to-hand"))
    with pytest.raises(ValueError, match="significance"):
        compare(result(), result(), significance=0.0)


@pytest.mark.parametrize(
    ("shift", "free", "code", "verdict"),
    [(0.0, (), 0, "agree"), (1e-3, (), 4, "differ"), (0.0, (HEIGHT,), 3, "agree")],
)
def test_command(tmp_path, capsys, shift, free, code, verdict):
    covariance = 1e-8 * (np.diag([1.0] * 5 + [0.0]) if free else np.eye(6))
    moved = X @ frames.exp([0.0, 0.0, 0.0, shift, 0.0, 0.0])
    result(digest="a").save(tmp_path / "a")
    status = "partial" if free else "ok"
    result(moved, covariance, status=status, free_directions=free).save(tmp_path / "b")
    assert cli.main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--json"]) == code
    told = capsys.readouterr()
    document = json.loads(told.out)
    assert document["verdict"] == verdict
    assert document["message"].split(":")[0] in told.err.replace("\n", " ")
    assert np.shape(document["differences"][0]["covariance"]) == (6, 6)


def test_command_refuses_a_significance_that_is_no_probability(tmp_path, capsys):
    result().save(tmp_path)
    out = str(tmp_path)
    assert cli.main(["compare", out, out, "--significance", "5"]) == 2
    assert "between 0 and 1" in capsys.readouterr().err
    assert cli.main(["compare", out, out, "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def refined(scene):
    """X and its covariance as a calibration finds them from a reconstruction."""
    reported = scene.robot_poses.base_T_gripper
    linear = linear_start(reported, scene.model.world_T_camera)
    found = refined_from(start_state(scene.model, [scene.camera], linear), scene.model, reported)
    return found.state.gripper_T_camera, found.observability.covariance, found.degrees_of_freedom


@pytest.mark.slow
@pytest.mark.simulation
def test_two_simulated_calibrations_of_one_camera():
    """One half of the images against the other, each with its own reconstruction and noise levels."""
    found = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        truth = truth_of(rng, 20, "general")
        pair = []
        for half, digest in ((slice(0, 10), "a"), (slice(10, 20), "b")):
            scene = scene_of(
                rng,
                replace(
                    truth,
                    base_T_gripper=truth.base_T_gripper[half],
                    world_T_camera=truth.world_T_camera[half],
                ),
                default_camera(),
                n_points=60,
                pixel_sigma=0.3,
                robot_rotation_sigma=np.deg2rad(0.1),
                robot_translation_sigma=1e-3,
                visibility=1.0,
                start_sigma=1e-4,
            )
            pair.append(result(*refined(scene), digest))
        found.append(compare(*pair).probability)
    assert stats.kstest(found, "uniform").pvalue > 1e-3
    assert np.mean(np.array(found) < 0.05) < 0.15
