"""A page of a large calibration: built soon, small, its points thinned."""

import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from handeye_fg import frames
from handeye_fg.graph.variables import State
from handeye_fg.io.results import Result
from handeye_fg.outcome.refined_scene import refined_scene
from handeye_fg.report import write_report
from handeye_fg.types import Rig, Tracks
from tabletop import TABLETOP

N_IMAGES, N_POINTS, SEEN_BY = 100, 100_000, 4
# A third of this on one quiet core; other processes may take most of the machine.
MOST_SECONDS = 30.0
MOST_BYTES = 3_000_000


def large(result: Result, images: Path) -> Result:
    """The result as if it had a hundred images and a hundred thousand points."""
    rng = np.random.default_rng(5)
    names = tuple(f"image_{i:03d}.jpg" for i in range(N_IMAGES))
    sources = sorted((TABLETOP / "images").iterdir())
    images.mkdir()
    for i, name in enumerate(names):
        (images / name).symlink_to(sources[i % len(sources)])
    placed = [image for image in result.images if image.registered]
    reports = tuple(replace(placed[i % len(placed)], name=name) for i, name in enumerate(names))
    poses = np.stack([image.base_T_camera for image in reports])
    points = rng.normal([0.5, 0.0, 0.0], [0.1, 0.1, 0.02], (N_POINTS, 3))
    state = State(
        world_T_camera=poses,
        points_world=points,
        gripper_T_cameras=result.matrix[None],
        base_T_world=np.eye(4),
        log_scale=0.0,
        cameras=(result.camera,),
        rig=Rig.of_one_camera(N_IMAGES),
    )
    tracks = Tracks(
        points_world=points,
        image_index=np.tile(np.arange(N_IMAGES), SEEN_BY * N_POINTS // N_IMAGES),
        point_index=np.repeat(np.arange(N_POINTS), SEEN_BY),
        pixels=rng.uniform(0.0, 900.0, (SEEN_BY * N_POINTS, 2)),
    )
    final = SimpleNamespace(
        state=state,
        tracks=tracks,
        sigma_scale=np.ones(len(tracks.pixels)),
        noise=result.noise,
        path=np.stack([result.matrix @ frames.exp(1e-3 / k * np.ones(6)) for k in range(1, 8)]),
    )
    scene = refined_scene(final, names, result.initial.gripper_T_camera, 0, images)
    return replace(result, images=reports, scene=scene)


def test_a_large_page_is_built_soon_and_is_small(result: Result, tmp_path: Path) -> None:
    write_report(result, tmp_path)  # what is imported and made once is not counted
    begin = time.perf_counter()
    many = large(result, tmp_path / "images")
    path = write_report(many, tmp_path)
    assert time.perf_counter() - begin < MOST_SECONDS
    assert path.stat().st_size <= MOST_BYTES
    text = path.read_text(encoding="utf-8")
    assert f"12000 of {N_POINTS} points are shown." in text
    assert f"40000 of {SEEN_BY * N_POINTS} observations" in text
    assert f"small pictures of 60 of {N_IMAGES} images" in text
    assert text.count("image_0") >= 100
