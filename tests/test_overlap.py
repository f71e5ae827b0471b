"""Predicted overlap against true co-visibility, on a long bench that no image shows whole."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.overlap import best_partners, expected_matches
from handeye_fg.simulate import disturbed
from handeye_fg.types import CameraModel, SfmModel, Tracks

CAMERA = CameraModel(
    model="OPENCV",
    width=960,
    height=720,
    params=np.array([820.0, 820, 480, 360, -0.06, 0.03, 0.0, 0.0]),
)
N_IMAGES, PARTNERS = 100, 10
# Features are matched reliably up to about this angle.
MATCHED = np.deg2rad(45.0)


@dataclass
class Bench:
    """Cameras (n, 4, 4), which points (p, 3) each of them sees (n, p), and a model of a few images."""

    poses: Array
    points: Array
    seen: NDArray[np.bool_]
    model: SfmModel

    def shared(self) -> Array:
        """How many points two images could match."""
        rays = self.points - self.poses[:, None, :3, 3]
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        result = np.zeros((N_IMAGES, N_IMAGES))
        for i in range(N_IMAGES):
            near = np.sum(rays[i] * rays, axis=2) > np.cos(MATCHED)
            result[i] = np.sum(self.seen[i] & self.seen & near, axis=1)
            result[i, i] = 0.0
        return result


@pytest.fixture(scope="module", params=["everywhere", "one end"])
def bench(request: pytest.FixtureRequest) -> Bench:
    """3 m by 0.6 m, seen from 0.5 m; the model has images of all of it, or of a third only."""
    rng = np.random.default_rng(3)
    points = rng.uniform([0.0, -0.3, 0.0], [3.0, 0.3, 0.1], (4000, 3))
    tilt = np.deg2rad(35.0) * np.sqrt(rng.uniform(size=N_IMAGES))
    azimuth, roll = rng.uniform(-np.pi, np.pi, (2, N_IMAGES))
    axis = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(N_IMAGES)])
    R = (
        Rotation.from_rotvec(tilt[:, None] * axis)
        * Rotation.from_euler("x", np.pi)
        * Rotation.from_rotvec(roll[:, None] * [0.0, 0.0, 1.0])
    ).as_matrix()
    aim = rng.uniform([0.2, -0.1, 0.0], [2.8, 0.1, 0.1], (N_IMAGES, 3))
    distance = rng.uniform(0.4, 0.6, (N_IMAGES, 1))
    poses = frames.pose(R, aim - distance * R[:, :, 2])
    local = np.einsum("nij,npi->npj", R, points - poses[:, None, :3, 3])
    pixels = local[..., :2] / local[..., 2:] * CAMERA.params[:2] + CAMERA.params[2:4]
    seen = np.all((pixels > 0.0) & (pixels < [960, 720]), axis=2) & (local[..., 2] > 0.0)
    far = 3.0 if request.param == "everywhere" else 1.0
    some = np.flatnonzero(aim[:, 0] < far)[:20]
    few = seen[some] & (seen[some].sum(axis=0) >= 2)
    kept, image, point = np.flatnonzero(few.any(axis=0)), *np.nonzero(few)
    model = SfmModel(
        names=tuple(str(i) for i in some),
        world_T_camera=poses[some],
        cameras=(CAMERA,),
        image_camera=np.zeros(len(some), dtype=np.int64),
        tracks=Tracks(
            points_world=points[kept],
            image_index=image,
            point_index=np.searchsorted(kept, point),
            pixels=pixels[some[image], point],
        ),
        mean_reprojection_px=0.0,
        unregistered=(),
    )
    return Bench(poses=poses, points=points, seen=seen, model=model)


def test_predicted_pairs_are_those_that_see_the_same(bench: Bench) -> None:
    # As a linear start from a few images places the cameras: off by half a degree and 5 mm.
    placed = disturbed(np.random.default_rng(4), bench.poses, np.deg2rad(0.5), 5e-3)
    expected = expected_matches(bench.model, placed, (CAMERA,), np.zeros(N_IMAGES, dtype=np.int64))
    np.testing.assert_array_equal(expected, expected.T)
    chosen = best_partners(expected, PARTNERS)
    np.testing.assert_array_equal(chosen, chosen.T)
    assert not chosen.diagonal().any()
    shared = bench.shared()
    covisible = shared >= 100
    # A fifth of all pairs is matched at most; in vain few, even where the model has no points.
    assert chosen.sum() < 0.2 * N_IMAGES**2
    assert np.mean(covisible[chosen]) > 0.7
    # Of the best partners that there are, most are among the chosen, of every image some.
    best = np.argsort(-shared, axis=1)[:, : PARTNERS // 2]
    recall = np.take_along_axis(chosen, best, axis=1)
    assert recall.mean() > 0.7
    assert recall.any(axis=1).all()
    useful = chosen & covisible
    assert useful.sum(axis=1).min() >= min(4, covisible.sum(axis=1).min())
    assert connected_components(useful)[0] == 1


def test_clusters_are_joined() -> None:
    """Two of them, in each of which all images have better partners than in the other."""
    matches = np.full((20, 20), 0.01)
    matches[:10, :10] = matches[10:, 10:] = 100.0
    matches[3, 17] = matches[17, 3] = 5.0
    np.fill_diagonal(matches, 0.0)
    chosen = best_partners(matches, 4)
    assert connected_components(chosen)[0] == 1
    assert chosen[3, 17]
    assert chosen[:10, 10:].sum() == 1


def test_the_other_side_of_a_thing_is_not_seen(bench: Bench) -> None:
    """Cameras below the bench look at the same points, which were seen from above only."""
    below = bench.poses.copy()
    below[1::2] = np.diag([1.0, -1.0, -1.0, 1.0]) @ below[1::2]
    expected = expected_matches(bench.model, below, (CAMERA,), np.zeros(N_IMAGES, dtype=np.int64))
    assert expected[::2, 1::2].max() < 0.05 * expected.max()
    assert expected[::2, ::2].max() == expected.max()


def test_a_thing_matches_only_where_features_are(bench: Bench) -> None:
    """Every second image shows nothing but its left half, one nothing at all."""
    rng = np.random.default_rng(0)
    features = [rng.uniform([0.0, 0.0], [960.0, 720.0], (6000, 2)) for _ in range(N_IMAGES)]
    features[1::2] = [pixels[pixels[:, 0] < 480.0] for pixels in features[1::2]]
    camera = np.zeros(N_IMAGES, dtype=np.int64)
    anywhere = expected_matches(bench.model, bench.poses, (CAMERA,), camera)
    found = expected_matches(bench.model, bench.poses, (CAMERA,), camera, features)
    np.testing.assert_allclose(found[::2, ::2], anywhere[::2, ::2], atol=0.01)
    assert found[1::2].sum() < 0.7 * anywhere[1::2].sum()
    features[3] = np.zeros((0, 2))
    blind = expected_matches(bench.model, bench.poses, (CAMERA,), camera, features)
    assert blind[3].max() <= 1.0


def test_a_point_without_observations_does_not_matter(bench: Bench) -> None:
    tracks = bench.model.tracks
    camera = np.zeros(N_IMAGES, dtype=np.int64)
    few = replace(tracks, points_world=tracks.points_world[:1000])
    rows = tracks.point_index < 1000
    few = replace(
        few,
        image_index=tracks.image_index[rows],
        point_index=tracks.point_index[rows],
        pixels=tracks.pixels[rows],
    )
    wanted = expected_matches(replace(bench.model, tracks=few), bench.poses, (CAMERA,), camera)
    for unseen in (0, 500, 1000):
        more = replace(
            few,
            points_world=np.insert(few.points_world, unseen, few.points_world[0], axis=0),
            point_index=few.point_index + (few.point_index >= unseen),
        )
        model = replace(bench.model, tracks=more)
        found = expected_matches(model, bench.poses, (CAMERA,), camera)
        np.testing.assert_allclose(found, wanted, rtol=1e-12)
