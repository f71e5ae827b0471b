"""Pairs of images whose matches look right and are not, and images that only the robot joins."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from handeye_fg import frames, parts
from handeye_fg.progress import silent
from handeye_fg.sfm import complete
from handeye_fg.sfm.guided import agreeing_pairs, likelier_turns, model_agreement, turns_of_pairs
from handeye_fg.sfm.mapping import Rung, map_images
from handeye_fg.sfm.model import to_fragment
from handeye_fg.sfm.tracks import _fill as fill_with_tracks
from handeye_fg.simulate import Scene, project, simulate_scene
from handeye_fg.turns import RobotTurns
from handeye_fg.types import SfmModel, Tracks

N_IMAGES = 10
# The second images of these pairs show a thing that the first ones show from elsewhere.
WRONG = {(0, 3), (0, 8), (1, 5), (2, 7), (4, 9), (6, 8)}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return simulate_scene(
        np.random.default_rng(5), n_images=N_IMAGES, n_points=60, pixel_sigma=0.3, start_sigma=0.0
    )


def turns_of(scene: Scene) -> RobotTurns:
    rotations = scene.robot_poses.base_T_gripper[:, :3, :3]
    return RobotTurns(rotations=rotations, setup="eye-in-hand")


def with_look_alikes(scene: Scene, rng: np.random.Generator) -> Tracks:
    """For each wrong pair 200 points that the second image shows as if taken from another place."""
    tracks = scene.model.tracks
    image, point, pixels = [tracks.image_index], [tracks.point_index], [tracks.pixels]
    start = len(tracks.points_world)
    for first, second in sorted(WRONG):
        look = rng.choice(scene.points_world, 200) + 0.1 * rng.normal(size=(200, 3)) * np.ptp(
            scene.points_world, axis=0
        )
        other = rng.choice([k for k in range(N_IMAGES) if k not in (first, second)])
        elsewhere = scene.world_T_camera[other]
        for number, world_T_camera in ((first, scene.world_T_camera[first]), (second, elsewhere)):
            camera_T_world = frames.inverse(world_T_camera)
            local = look @ camera_T_world[:3, :3].T + camera_T_world[:3, 3]
            image.append(np.full(200, number))
            point.append(np.arange(start, start + 200))
            pixels.append(project(scene.camera, local) + 0.3 * rng.normal(size=(200, 2)))
        start += 200
    return Tracks(
        points_world=np.zeros((start, 3)),
        image_index=np.concatenate(image),
        point_index=np.concatenate(point),
        pixels=np.concatenate(pixels),
    )


def filled(path: Path, scene: Scene, tracks: Tracks) -> Path:
    fill_with_tracks(
        path,
        scene.model.names,
        tracks.image_index,
        tracks.point_index,
        tracks.pixels,
        {".": scene.camera},
    )
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = 0
    pycolmap.geometric_verification(path, two_view_geometry_options=options)
    return path


@pytest.fixture(scope="module")
def look_alikes(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    tracks = with_look_alikes(scene, np.random.default_rng(6))
    return filled(tmp_path_factory.mktemp("look_alikes") / "database.db", scene, tracks)


def verified(database: Path) -> set[tuple[int, int]]:
    pairs = turns_of_pairs(database, 0)
    return set(zip(pairs.i.tolist(), pairs.j.tolist(), strict=True))


def mapped(database: Path, folder: Path) -> pycolmap.Reconstruction | None:
    models = map_images(
        database,
        folder,
        Rung(relaxed=True, refine=False),
        n_images=N_IMAGES,
        file_cameras=None,
        seed=0,
        progress=silent,
    )
    return next(iter(models), None)


def test_the_robot_tells_look_alikes_from_right_pairs(
    scene: Scene, look_alikes: Path, tmp_path: Path
) -> None:
    before = verified(look_alikes)
    assert before >= WRONG  # they are what their images match best in
    copy = tmp_path / "agreeing.db"
    assert agreeing_pairs(look_alikes, copy, turns_of(scene), 0)
    after = verified(copy)
    assert not after & WRONG
    assert len(after) >= 0.9 * len(before - WRONG)
    assert verified(look_alikes) == before
    found = mapped(copy, tmp_path)
    assert found is not None
    assert model_agreement([to_fragment(found)], scene.model.names, turns_of(scene)) > 0.99


def test_pairs_tell_the_setup(scene: Scene, look_alikes: Path) -> None:
    """A wrong one must not stand in the way of the right model: it is told when there is one."""
    right = turns_of(scene)
    assert likelier_turns(look_alikes, right, 0) is right
    assert likelier_turns(look_alikes, right.inverted(), 0).setup == right.setup


def test_no_copy_where_nothing_agrees(scene: Scene, look_alikes: Path, tmp_path: Path) -> None:
    rows = np.random.default_rng(0).permutation(N_IMAGES)
    shuffled = RobotTurns(rotations=turns_of(scene).rotations[rows], setup="eye-in-hand")
    assert not agreeing_pairs(look_alikes, tmp_path / "agreeing.db", shuffled, 0)
    assert list(tmp_path.iterdir()) == []


def test_a_model_is_judged_by_all_images_not_by_those_it_has(scene: Scene, tmp_path: Path) -> None:
    database = filled(tmp_path / "database.db", scene, scene.model.tracks)
    found = mapped(database, tmp_path)
    assert found is not None
    names, turns = scene.model.names, turns_of(scene)
    whole = to_fragment(found)
    assert model_agreement([whole], names, turns) > 0.99
    half = replace(whole, names=whole.names[:5], world_T_camera=whole.world_T_camera[:5])
    assert model_agreement([half], names, turns) == pytest.approx(0.25, abs=0.01)
    assert model_agreement([], names, turns) == 0.0


def only(scene: Scene, kept: list[int]) -> SfmModel:
    """The model with some of its images; the others were not placed."""
    names = scene.model.names
    return replace(
        parts.only(scene.model, [names[i] for i in kept]),
        unregistered=tuple((names[i], "why") for i in range(N_IMAGES) if i not in kept),
    )


@pytest.fixture(scope="module")
def halves(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The last three images see points of their own; what they share with the others is lost."""
    tracks = scene.model.tracks
    other_side = tracks.image_index >= 7
    separate = replace(
        tracks,
        points_world=np.concatenate([tracks.points_world] * 2),
        point_index=tracks.point_index + other_side * len(tracks.points_world),
    )
    folder = tmp_path_factory.mktemp("halves")
    filled(folder / "database.db", scene, separate)
    return folder


def test_images_that_only_the_robot_joins_are_added(scene: Scene, halves: Path) -> None:
    model = only(scene, list(range(7)))
    off = frames.exp(np.array([2e-4, -2e-4, 2e-4, 0, 0, 0]))
    expected = {name: scene.world_T_camera[i] @ off for i, name in enumerate(scene.model.names)}
    added = {name: expected[name] for name, _ in model.unregistered}
    full = complete(halves, model, added, {".": scene.camera})
    assert full.names == scene.model.names
    assert full.unregistered == ()
    assert full.mean_reprojection_px < 0.6
    assert (np.bincount(full.tracks.image_index) > 20).all()
    # Within either half the cameras are as they were; the halves hang together by what was expected.
    for part in (range(7), range(7, 10)):
        true = frames.inverse(scene.world_T_camera[part[0]]) @ scene.world_T_camera[list(part)]
        found = frames.inverse(full.world_T_camera[part[0]]) @ full.world_T_camera[list(part)]
        angles = np.rad2deg(
            frames.rotation_angle(np.swapaxes(true, 1, 2)[:, :3, :3] @ found[:, :3, :3])
        )
        assert angles.max() < 0.1


def test_where_expectation_and_matches_disagree_nothing_is_added(
    scene: Scene, halves: Path
) -> None:
    model = only(scene, list(range(7)))
    wrong = [scene.world_T_camera[i] @ frames.exp(0.2 * np.arange(i - 5, i + 1)) for i in (7, 8, 9)]
    names = [name for name, _ in model.unregistered]
    expected = dict(zip(names, wrong, strict=True))
    assert complete(halves, model, expected, {".": scene.camera}) is model
