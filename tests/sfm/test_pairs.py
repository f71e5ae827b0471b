"""The pairs to match, by the robot: which images begin, and what happens where poses are wrong."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pycolmap
import pytest

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.options import SfmOptions
from handeye_fg.progress import silent
from handeye_fg.sfm.features import STRICT
from handeye_fg.sfm.matching import Matcher
from handeye_fg.sfm.model import to_sfm_model
from handeye_fg.sfm.pairs import (
    RobotGuide,
    beginnings,
    by_robot,
    match_by_robot,
    not_as_placed,
)
from handeye_fg.sfm.stages import Stage
from handeye_fg.simulate import simulate_poses
from handeye_fg.types import SfmModel

N_IMAGES = 36
Place = Callable[[Sequence[SfmModel]], tuple[SfmModel, Array] | None]


@dataclass
class Recorder:
    """Stands in for a matcher: keeps what it was asked for."""

    database: Path
    seed: int = 0
    asked: list[set[tuple[int, int]]] = field(default_factory=list)
    all: bool = False
    begun: tuple[str, ...] = ()

    def match_pairs(self, pairs: Array) -> None:
        self.asked.append(set(map(tuple, pairs.tolist())))

    def match_all(self) -> None:
        self.all = True


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """Cameras all around some points, with every pair of them matched in a database."""
    pycolmap.set_random_seed(2)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = options.num_cameras_per_rig = 1
    options.num_frames_per_rig, options.num_points3D = N_IMAGES, 200
    database = tmp_path_factory.mktemp("pairs") / "database.db"
    with pycolmap.Database.open(database) as db:
        model = to_sfm_model(pycolmap.synthesize_dataset(options, db))
    return SimpleNamespace(database=database, model=model, poses=model.world_T_camera)


def placing(model: SfmModel, poses: Array | None) -> Place:
    """Places images at poses, in the world of one model; None: nowhere."""
    return lambda _: None if poses is None else (model, poses)


def matched(synthetic, poses: Array | None, map_some=None) -> Recorder:
    recorder = Recorder(synthetic.database)
    recorder.begun = match_by_robot(
        cast("Matcher", recorder),
        synthetic.model.names,
        RobotGuide(base_T_gripper=synthetic.poses, place=placing(synthetic.model, poses)),
        map_some or (lambda _k, _names: synthetic.model),
    )
    return recorder


def test_few_pairs_are_matched(synthetic) -> None:
    recorder = matched(synthetic, synthetic.poses)
    assert not recorder.all
    beginning, chosen, doubtful = recorder.asked
    assert len(beginning) == 16 * 15 // 2
    assert beginning == set(combinations(map(synthetic.model.names.index, recorder.begun), 2))
    assert 5 * N_IMAGES <= len(chosen) <= 10 * N_IMAGES
    assert doubtful == set()


def test_images_with_wrong_poses_are_matched_with_all(synthetic) -> None:
    swapped = synthetic.poses.copy()
    swapped[[5, 20]] = swapped[[20, 5]]
    recorder = matched(synthetic, swapped)
    assert not recorder.all
    others = set(range(N_IMAGES)) - {5, 20}
    wanted = {tuple(sorted((i, j))) for i in (5, 20) for j in others} | {(5, 20)}
    assert recorder.asked[-1] == wanted


def test_poses_of_no_use_mean_all_pairs(synthetic) -> None:
    shuffled = synthetic.poses[np.random.default_rng(0).permutation(N_IMAGES)]
    recorder = matched(synthetic, shuffled)
    assert recorder.all
    assert recorder.begun == ()


@pytest.mark.parametrize("what", ["no model", "no agreement"])
def test_without_a_beginning_all_pairs_are_matched(synthetic, what: str) -> None:
    tried: list[tuple[str, ...]] = []

    def map_some(_: int, names: tuple[str, ...]) -> SfmModel | None:
        tried.append(names)
        return None if what == "no model" else cast("SfmModel", synthetic.model)

    recorder = matched(synthetic, None, map_some)
    assert recorder.all
    assert recorder.begun == ()
    assert len(tried) == len(set(tried)) == 2


def test_unmatched_images_are_not_as_placed(synthetic, tmp_path: Path) -> None:
    database = tmp_path / "copy.db"
    database.write_bytes(synthetic.database.read_bytes())
    with pycolmap.Database.open(database) as db:
        for other in range(2, N_IMAGES + 1):
            db.delete_two_view_geometry(1, other)
    chosen = ~np.eye(N_IMAGES, dtype=bool)
    doubtful = not_as_placed(database, chosen, synthetic.poses, seed=0)
    np.testing.assert_array_equal(np.flatnonzero(doubtful), [0])


@pytest.mark.parametrize("n", [3, 16, 60])
def test_beginnings(n: int) -> None:
    poses, _, _ = simulate_poses(np.random.default_rng(n), n_poses=n)
    (spread,), (compact,) = beginnings(poses, ["."] * n)
    assert len(set(spread.tolist())) == len(set(compact.tolist())) == min(n, 16)
    if n == 60:
        extent = [np.sqrt(np.var(poses[which, :3, 3], axis=0).sum()) for which in (spread, compact)]
        assert extent[0] > extent[1]


def test_each_of_several_cameras_begins_by_itself() -> None:
    """Only then all together, the images at one pose with each other."""
    poses, _, _ = simulate_poses(np.random.default_rng(1), n_poses=40)
    twice = np.concatenate([poses, poses @ frames.exp(np.full(6, 1e-12))])
    apart, near, (together,), (_,) = beginnings(twice, ["b"] * 40 + ["a"] * 40)
    for second, first in (apart, near):
        assert len(first) == len(second) == 16
        np.testing.assert_array_equal(first + 40, second)
    assert len(together) == 16
    np.testing.assert_array_equal(together[:8] + 40, together[8:])


def test_when_the_robot_is_asked() -> None:
    assert not by_robot(SfmOptions(), 30)
    assert by_robot(SfmOptions(), 31)
    assert by_robot(SfmOptions(pairs="robot"), 3)
    assert not by_robot(SfmOptions(pairs="all"), 300)


def test_names_with_blanks_are_matched(synthetic, tmp_path: Path) -> None:
    """COLMAP's list of pairs ends names at blanks."""
    database = tmp_path / "database.db"
    database.write_bytes(synthetic.database.read_bytes())
    with pycolmap.Database.open(database) as db:
        db.clear_descriptors()
        for image in db.read_all_images():
            db.write_descriptors(
                image.image_id,
                pycolmap.FeatureDescriptors(
                    pycolmap.FeatureExtractorType.SIFT,
                    np.random.default_rng(0).integers(
                        0, 255, (db.num_keypoints_for_image(image.image_id), 128), dtype=np.uint8
                    ),
                ),
            )
            image.name = f"view {image.image_id}.jpg"
            db.update_image(image)
        names = [image.name for image in db.read_all_images()]
        db.clear_matches()
        db.clear_two_view_geometries()
    matcher = Matcher(
        stage=Stage(folder=database.parent, key={}, facts={"images": dict.fromkeys(names)}),
        sensitivity=STRICT,
        options=SfmOptions(threads=1),
        seed=0,
        progress=silent,
    )
    matcher.match_pairs(np.array([[0, 1], [3, 5]]))
    matcher.match_pairs(np.array([[0, 1], [2, 4]]))
    with pycolmap.Database.open(database) as db:
        assert db.num_matched_image_pairs() == 3
        assert all(db.exists_matches(*pair) for pair in ((1, 2), (4, 6), (3, 5)))
        assert [image.name for image in db.read_all_images()] == names
