"""What motions of every kind determine: the table of the paper's summary, row by row."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import linalg, stats

from handeye_fg.errors import InputDataError, UnobservableError
from handeye_fg.frames import Array, exp, inverse, log, pose, scaled
from handeye_fg.motions import MotionPairs, PosePairs, as_motions
from handeye_fg.observability import LIMITS, Observability, analyse
from handeye_fg.priors import Prior
from handeye_fg.simulate import disturbed
from handeye_fg.solvers import Solution, first_order_covariance, partial

UNHURRIED = settings(deadline=None, max_examples=25)

X_RANDOM = exp(np.array([0.9, -0.3, 1.4, 0.05, -0.02, 0.11]))
SCALE = 0.37
Z_AXIS, X_AXIS, Y_AXIS = np.eye(3)[[2, 0, 1]]
FIRST, SECOND = np.array([0.2, 0.1, -0.15]), np.array([-0.1, 0.25, 0.1])
TILTED = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
OTHER = np.array([1.0, 0.3, 0.2]) / np.linalg.norm([1.0, 0.3, 0.2])

# An ordinary arm and a good reconstruction: radians and metres per axis.
ROTATION_NOISE, TRANSLATION_NOISE = 1.75e-4, 1e-4


def turn(axis: Array, angle: float) -> Array:
    return exp(np.concatenate([angle * axis, np.zeros(3)]))[:3, :3]


def T(translation: Array) -> Array:
    return pose(np.eye(3), translation)


def R(axis: Array, angle: float) -> Array:
    return pose(turn(axis, angle), np.zeros(3))


def P(axis: Array, angle: float, translation: Array) -> Array:
    return pose(turn(axis, angle), translation - axis * (axis @ translation))


def S(axis: Array, angle: float, translation: Array) -> Array:
    return pose(turn(axis, angle), translation)


# Motions of the gripper, and the free directions in order: t translation, r rotation, s scale; a
# scale takes a direction of the position with it wherever the gripper turns.
TABLE = {
    "one T": ([T(FIRST)], "tttr"),
    "one R": ([R(TILTED, 1.0)], "tsr"),
    "one P": ([P(TILTED, 1.0, FIRST)], "tsr"),
    "one S": ([S(TILTED, 1.0, FIRST)], "tr"),
    "T + T": ([T(FIRST), T(SECOND)], "ttt"),
    "T + R": ([T(FIRST), R(TILTED, 1.0)], "t"),
    "T + P": ([T(FIRST), P(TILTED, 1.0, SECOND)], "t"),
    "T + S": ([T(FIRST), S(TILTED, 1.0, SECOND)], "t"),
    "R + R": ([R(TILTED, 1.0), R(OTHER, 0.8)], "s"),
    "R + R + R": ([R(TILTED, 1.0), R(OTHER, 0.8), R(Y_AXIS, -0.7)], "s"),
    "R + P": ([R(TILTED, 1.0), P(OTHER, 0.8, FIRST)], ""),
    "R + S": ([R(TILTED, 1.0), S(OTHER, 0.8, FIRST)], ""),
    "P + P": ([P(TILTED, 1.0, FIRST), P(OTHER, 0.8, SECOND)], ""),
    "P + S": ([P(TILTED, 1.0, FIRST), S(OTHER, 0.8, SECOND)], ""),
    "S + S": ([S(TILTED, 1.0, FIRST), S(OTHER, 0.8, SECOND)], ""),
    "P + P, one axis": ([P(TILTED, 1.0, FIRST), P(TILTED, -0.8, SECOND)], "t"),
    "S + R, one axis": ([S(TILTED, 1.0, FIRST), R(TILTED, -0.8)], "t"),
    "S + S, one axis": ([S(TILTED, 1.0, FIRST), S(TILTED, 0.6, SECOND)], "t"),
    "R + R, one axis": ([R(TILTED, 1.0), R(TILTED, -0.6)], "tsr"),
    "T + T + R + R": ([T(FIRST), T(SECOND), R(TILTED, 1.0), R(OTHER, 0.8)], ""),
}
LETTERS = {"translation": "t", "rotation": "r", "scale": "s"}


def as_poses(
    motions: list[Array], X: Array, scale: float, rng: np.random.Generator, noise: float = 0.0
) -> PosePairs:
    """Poses that the motions lead through, as robot and camera report them."""
    gripper = [exp(np.array([0.3, 0.2, -0.5, 0.4, 0.1, 0.6]))]
    for motion in motions:
        gripper.append(gripper[-1] @ motion)
    return seen(np.array(gripper), X, scale, rng, noise)


def seen(
    gripper: Array, X: Array, scale: float, rng: np.random.Generator, noise: float
) -> PosePairs:
    """Robot and camera poses; the camera's have a fifth of the robot's noise."""
    camera = scaled(exp(np.array([0.4, -1.1, 0.7, 0.3, 0.2, -0.5])) @ gripper @ X, 1.0 / scale)
    rotation, translation = noise * ROTATION_NOISE, noise * TRANSLATION_NOISE
    return PosePairs(
        base_T_gripper=disturbed(rng, gripper, rotation, translation),
        world_T_camera=disturbed(rng, camera, 0.2 * rotation, 0.2 * translation / scale),
    )


def separate(motions: list[Array], X: Array, scale: float) -> MotionPairs:
    """Motions that share no pose."""
    A, k = np.array(motions), len(motions)
    return MotionPairs(
        i=2 * np.arange(k),
        j=2 * np.arange(k) + 1,
        gi_T_gj=A,
        ci_T_cj=scaled(inverse(X) @ A @ X, 1.0 / scale),
    )


def answer(
    data: PosePairs | MotionPairs, *, scale_known: bool = False, priors: tuple[Prior, ...] = ()
) -> tuple[Solution, Array, Observability]:
    found = partial(data, scale_known=scale_known, priors=priors)
    covariance = first_order_covariance(data, found, scale_known=scale_known, priors=priors)
    return found, covariance, analyse(covariance, np.asarray(found.gripper_T_camera), "gripper")


def kinds(found: Observability) -> str:
    return "".join(LETTERS[direction.kind] for direction in found.free_directions)


def misfit(data: PosePairs | MotionPairs, found: Solution) -> float:
    pairs, X = as_motions(data), np.asarray(found.gripper_T_camera)
    right = X @ scaled(pairs.ci_T_cj, found.metres_per_world_unit)
    return float(np.abs(pairs.gi_T_gj @ X - right).max())


def random_mount(rng: np.random.Generator) -> Array:
    direction = rng.standard_normal(3)
    return pose(
        turn(np.eye(3)[0], 0.0) @ exp(rng.uniform(-1.7, 1.7, 6))[:3, :3],
        rng.uniform(0.03, 0.12) * direction / np.linalg.norm(direction),
    )


# --- the table ------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", TABLE)
@pytest.mark.parametrize("form", ["poses", "motions"])
def test_table_without_noise(row: str, form: str) -> None:
    motions, free = TABLE[row]
    data = (
        as_poses(motions, X_RANDOM, SCALE, np.random.default_rng(0))
        if form == "poses"
        else separate(motions, X_RANDOM, SCALE)
    )
    found, _, observed = answer(data)
    assert kinds(observed) == free
    assert observed.free_basis.shape[1] == len(free)
    # Whatever was chosen along the free directions, it closes A X = X B: the rest is exact.
    assert misfit(data, found) < 1e-12
    X = np.asarray(found.gripper_T_camera)
    if "r" not in free:
        np.testing.assert_allclose(X[:3, :3], X_RANDOM[:3, :3], atol=1e-9)
    if "s" not in free:
        assert found.metres_per_world_unit == pytest.approx(SCALE, rel=1e-9)
    else:
        assert observed.log_scale_std == np.inf
    if free == "s":
        ratio = X[:3, 3] / found.metres_per_world_unit
        np.testing.assert_allclose(ratio, X_RANDOM[:3, 3] / SCALE, atol=1e-9)
    if free in ("", "t"):
        axis = observed.free_directions[0].vector if free else np.zeros(3)
        missing = X[:3, 3] - X_RANDOM[:3, 3]
        np.testing.assert_allclose(missing, axis * (axis @ missing), atol=1e-9)


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


def test_free_directions_are_those_of_the_table() -> None:
    def vectors(row: str) -> list[Array]:
        data = separate(TABLE[row][0], X_RANDOM, SCALE)
        return [direction.vector for direction in answer(data)[2].free_directions]

    np.testing.assert_allclose(vectors("T + T"), np.eye(3))
    turns = vectors("one T")[3]
    np.testing.assert_allclose(np.abs(turns @ FIRST), np.linalg.norm(FIRST), atol=1e-9)
    for row in ("one R", "one P", "one S", "R + R, one axis"):
        directions = vectors(row)
        np.testing.assert_allclose(np.abs(directions[0] @ TILTED), 1.0, atol=1e-9)
        np.testing.assert_allclose(np.abs(directions[-1] @ TILTED), 1.0, atol=1e-6)
    (along,) = vectors("R + R")
    t_X = X_RANDOM[:3, 3]
    np.testing.assert_allclose(np.abs(along @ t_X), np.linalg.norm(t_X), atol=1e-9)


def test_a_known_scale_leaves_less_free() -> None:
    free = {"one R": "tr", "one P": "tr", "R + R": "", "R + R, one axis": "tr", "T + T": "ttt"}
    for row, wanted in free.items():
        data = separate(TABLE[row][0], X_RANDOM, 1.0)
        found, covariance, observed = answer(data, scale_known=True)
        assert kinds(observed) == wanted
        assert found.metres_per_world_unit == 1.0
        assert misfit(data, found) < 1e-12
        np.testing.assert_array_equal(covariance[6], 0.0)


# --- noise ----------------------------------------------------------------------------------------


def many_poses(kind: str, rng: np.random.Generator, n: int = 12) -> Array:
    vectors, positions = np.zeros((n, 6)), rng.uniform(-0.2, 0.2, (n, 3))
    if kind in ("general", "rotations"):
        vectors[:, :3] = rng.uniform(-0.6, 0.6, (n, 3))
    if kind in ("scara", "planar", "one rotation axis"):
        vectors[:, 2] = rng.uniform(-2.0, 2.0, n)
    if kind in ("rotations", "one rotation axis"):
        positions[:] = 0.0
    if kind == "planar":
        positions[:, 2] = 0.0
    tool = exp(np.concatenate([rng.uniform(-1.0, 1.0, 3), np.zeros(3)]))
    gripper: Array = pose(exp(vectors)[:, :3, :3], positions)
    return np.asarray(exp(rng.uniform(-1.0, 1.0, 6)) @ gripper @ tool)


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


# --- priors ---------------------------------------------------------------------------------------


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


# --- properties -----------------------------------------------------------------------------------

twists = arrays(np.float64, 6, elements=st.floats(-1.0, 1.0)).map(
    lambda xi: xi * [1.7, 1.7, 1.7, 0.1, 0.1, 0.1]
)
rows = st.sampled_from(sorted(TABLE))
scales = st.floats(-3.0, 3.0).map(np.exp)


@UNHURRIED
@given(rows, twists, scales)
def test_any_mounting_closes_the_chain(row: str, xi: Array, scale: float) -> None:
    data = separate(TABLE[row][0], exp(xi), scale)
    found, covariance, _ = answer(data)
    assert misfit(data, found) < 1e-9
    assert np.isfinite(covariance).all()
    assert np.linalg.eigvalsh(covariance / np.outer(LIMITS, LIMITS))[0] > 0.0


@UNHURRIED
@given(rows, twists, twists)
def test_the_frames_do_not_matter(row: str, base: Array, world: Array) -> None:
    data = as_poses(TABLE[row][0], X_RANDOM, SCALE, np.random.default_rng(1))
    moved = PosePairs(
        base_T_gripper=exp(base) @ data.base_T_gripper,
        world_T_camera=exp(world) @ data.world_T_camera,
    )
    found, again = (partial(poses, scale_known=False) for poses in (data, moved))
    np.testing.assert_allclose(again.gripper_T_camera, found.gripper_T_camera, atol=1e-7)
    assert again.metres_per_world_unit == pytest.approx(found.metres_per_world_unit, rel=1e-7)


@UNHURRIED
@given(st.floats(0.01, 100.0))
def test_the_unit_of_the_world_scales_the_scale_only(factor: float) -> None:
    rng = np.random.default_rng(6)
    data = seen(many_poses("scara", rng), X_RANDOM, SCALE, rng, 1.0)
    other = PosePairs(
        base_T_gripper=data.base_T_gripper, world_T_camera=scaled(data.world_T_camera, factor)
    )
    found, again = (partial(poses, scale_known=False) for poses in (data, other))
    np.testing.assert_allclose(again.gripper_T_camera, found.gripper_T_camera, atol=1e-8)
    assert again.metres_per_world_unit * factor == pytest.approx(
        found.metres_per_world_unit, rel=1e-7
    )


# --- what has no answer ---------------------------------------------------------------------------


@pytest.mark.parametrize("who", ["robot", "camera"])
def test_nothing_moved(who: str) -> None:
    data = as_poses(TABLE["S + S"][0], X_RANDOM, SCALE, np.random.default_rng(2))
    still = np.stack([np.eye(4)] * 3)
    poses = {"base_T_gripper": data.base_T_gripper, "world_T_camera": data.world_T_camera}
    poses["base_T_gripper" if who == "robot" else "world_T_camera"] = still
    with pytest.raises(UnobservableError, match=f"the {who} did not move"):
        partial(PosePairs(**poses), scale_known=False)


def test_mirrored_motions_are_another_convention() -> None:
    rng = np.random.default_rng(8)
    for kind in ("general", "translations"):
        data = seen(many_poses(kind, rng), X_RANDOM, SCALE, rng, 0.1)
        mirrored = PosePairs(
            base_T_gripper=data.base_T_gripper, world_T_camera=scaled(data.world_T_camera, -1.0)
        )
        with pytest.raises(InputDataError, match="scale came out negative"):
            partial(mirrored, scale_known=False)


def test_opposite_axes_are_taken_to_each_other() -> None:
    """The smallest turn is half a turn, about any axis across them."""
    half = pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    data = separate([T(0.3 * Z_AXIS)], half, 1.0)
    found, _, observed = answer(data)
    assert misfit(data, found) < 1e-12
    assert kinds(observed) == "tttr"


def test_the_complement_is_orthogonal_to_the_free_directions() -> None:
    rng = np.random.default_rng(9)
    _, covariance, observed = answer(seen(many_poses("scara", rng), X_RANDOM, SCALE, rng, 10.0))
    free = LIMITS[:6, None] * observed.free_basis[:6]
    np.testing.assert_allclose(observed.covariance @ free, 0.0, atol=1e-12)
    kept = linalg.null_space(free.T)
    np.testing.assert_allclose(
        kept.T @ observed.covariance @ kept, kept.T @ covariance[:6, :6] @ kept, rtol=1e-3
    )
