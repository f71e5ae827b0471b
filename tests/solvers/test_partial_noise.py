"""What noisy motions determine, and what a prior adds."""

import numpy as np
import pytest
from scipy import linalg, stats

from exact_poses import X_RANDOM
from handeye_fg.frames import inverse, log, scaled
from handeye_fg.motions import PosePairs, as_motions
from handeye_fg.observability import LIMITS
from handeye_fg.priors import Prior
from handeye_fg.simulate import disturbed
from kinds_of_motion import (
    SCALE,
    TABLE,
    answer,
    as_poses,
    kinds,
    many_poses,
    random_mount,
    seen,
    separate,
)


@pytest.mark.simulation
@pytest.mark.parametrize("row", TABLE)
def test_table_with_noise(row: str) -> None:
    motions, free = TABLE[row]
    rng = np.random.default_rng(len(row))
    right = 0
    for _ in range(100):
        X, scale = random_mount(rng), float(np.exp(rng.uniform(-3.0, 2.0)))
        _, _, observed = answer(as_poses(motions, X, scale, rng, noise=1.0))
        right += kinds(observed) == free
    assert right >= 99


MANY = {
    "general": "",
    "scara": "t",
    "planar": "t",
    "translations": "ttt",
    "rotations": "s",
    "one rotation axis": "tsr",
}


@pytest.mark.simulation
@pytest.mark.parametrize("kind", MANY)
@pytest.mark.parametrize("noise", [0.3, 10.0])
def test_many_noisy_poses(kind: str, noise: float) -> None:
    """The free directions are told, and the determined part is as accurate as it says."""
    rng = np.random.default_rng(7)
    right, nees, dims = 0, [], 0
    for _ in range(100):
        X, scale = random_mount(rng), float(np.exp(rng.uniform(-3.0, 2.0)))
        data = seen(many_poses(kind, rng), X, scale, rng, noise)
        found, _, observed = answer(data)
        right += kinds(observed) == MANY[kind]
        error = log(inverse(np.asarray(found.gripper_T_camera)) @ X)
        values, vectors = np.linalg.eigh(observed.covariance)
        kept = values > 1e-12 * values[-1]
        dims = int(kept.sum())
        nees.append(float(np.sum((vectors[:, kept].T @ error) ** 2 / values[kept])))
    assert right >= 99
    if "r" in MANY[kind]:  # half a turn off, tangents say nothing
        return
    # 24 to 33 poses' worth of degrees of freedom stand behind each sigma: F, not chi-square. Its
    # mean is up to 1.1, and the mean of 100 draws scatters by a sixth.
    assert 0.75 * dims < np.mean(nees) < 1.45 * dims
    assert np.mean(np.array(nees) > stats.chi2.isf(0.05, dims)) < 0.17


@pytest.mark.parametrize(("kind", "free"), [("scara", "t"), ("rotations", "s")])
def test_many_poses_do_not_make_noise_a_motion(kind: str, free: str) -> None:
    """60 poses with 0.02 degrees of wobble seem to tell the height to 30 mm; it is only noise."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        poses = many_poses(kind, rng, n=60)
        camera = scaled(poses @ X_RANDOM, 1.0 / SCALE)
        data = PosePairs(
            base_T_gripper=disturbed(rng, poses, 3.5e-4, 1e-4),
            world_T_camera=disturbed(rng, camera, 3.5e-5, 2e-5 / SCALE),
        )
        assert kinds(answer(data)[2]) == free


def test_motions_that_share_poses_do_not_count_twice() -> None:
    rng = np.random.default_rng(3)
    data = seen(many_poses("general", rng), X_RANDOM, SCALE, rng, 1.0)
    found, covariance, _ = answer(data)
    again, of_motions, _ = answer(as_motions(data))
    np.testing.assert_allclose(again.gripper_T_camera, found.gripper_T_camera, atol=1e-7)
    np.testing.assert_allclose(of_motions, covariance, rtol=1e-3, atol=1e-14)


def test_weightless_rows_count_nothing() -> None:
    rng = np.random.default_rng(4)
    data = seen(many_poses("scara", rng), X_RANDOM, SCALE, rng, 1.0)
    spoilt, weights = np.array(data.base_T_gripper), np.ones(12)
    spoilt[5, :3, 3] += 1.0
    weights[5] = 0.0
    weighted = PosePairs(base_T_gripper=spoilt, world_T_camera=data.world_T_camera, weights=weights)
    without = PosePairs(
        base_T_gripper=np.delete(data.base_T_gripper, 5, axis=0),
        world_T_camera=np.delete(data.world_T_camera, 5, axis=0),
    )
    found, covariance, _ = answer(weighted)
    wanted, wanted_covariance, _ = answer(without)
    np.testing.assert_allclose(found.gripper_T_camera, wanted.gripper_T_camera, atol=1e-9)
    np.testing.assert_allclose(covariance, wanted_covariance, rtol=1e-6, atol=1e-15)


def test_the_complement_is_orthogonal_to_the_free_directions() -> None:
    rng = np.random.default_rng(9)
    _, covariance, observed = answer(seen(many_poses("scara", rng), X_RANDOM, SCALE, rng, 10.0))
    free = LIMITS[:6, None] * observed.free_basis[:6]
    np.testing.assert_allclose(observed.covariance @ free, 0.0, atol=1e-12)
    kept = linalg.null_space(free.T)
    np.testing.assert_allclose(
        kept.T @ observed.covariance @ kept, kept.T @ covariance[:6, :6] @ kept, rtol=1e-3
    )


@pytest.mark.parametrize("kind", ["scara", "planar"])
def test_a_prior_completes_a_scara(kind: str) -> None:
    rng = np.random.default_rng(5)
    data = seen(many_poses(kind, rng), X_RANDOM, SCALE, rng, 1.0)
    (direction,) = answer(data)[2].free_directions
    axis = direction.vector
    prior = Prior("translation-along", tuple(axis), float(axis @ X_RANDOM[:3, 3]) + 0.002, 0.001)
    found, covariance, observed = answer(data, priors=(prior,))
    assert observed.free_directions == ()
    X = np.asarray(found.gripper_T_camera)
    assert X[:3, 3] @ axis == pytest.approx(prior.value, abs=0.1 * prior.std)
    in_camera = X[:3, :3].T @ axis
    assert np.sqrt(in_camera @ covariance[3:6, 3:6] @ in_camera) == pytest.approx(1e-3, rel=0.01)


def test_a_prior_gives_the_scale_of_pure_rotations() -> None:
    data = separate(TABLE["R + R"][0], X_RANDOM, SCALE)
    axis = X_RANDOM[:3, 3] / np.linalg.norm(X_RANDOM[:3, 3])
    prior = Prior("translation-along", tuple(axis), float(np.linalg.norm(X_RANDOM[:3, 3])), 1e-3)
    found, _, observed = answer(data, priors=(prior,))
    assert observed.free_directions == ()
    np.testing.assert_allclose(found.gripper_T_camera, X_RANDOM, atol=1e-6)
    assert found.metres_per_world_unit == pytest.approx(SCALE, rel=1e-5)
