"""Observations that are not of their point, among right ones; ``scattered``, ``astray``."""

from dataclasses import replace

import numpy as np

from handeye_fg.frames import inverse
from handeye_fg.simulate.scenes import Scene, project
from handeye_fg.types import Tracks


def scattered(scene: Scene, rng: np.random.Generator, part: float) -> Tracks:
    """The scene's tracks with this part of the observations anywhere in their image."""
    tracks = scene.model.tracks
    pixels = np.array(tracks.pixels)
    bad = rng.choice(len(pixels), int(part * len(pixels)), replace=False)
    size = [scene.camera.width, scene.camera.height]
    pixels[bad] = rng.uniform([0.0, 0.0], size, (len(bad), 2))
    return replace(tracks, pixels=pixels)


def astray(
    scene: Scene, rng: np.random.Generator, part: float, distances: tuple[float, float]
) -> Tracks:
    """The scene's tracks, of which twice this part see another point in half of their images.

    So the part counts observations. The model has the point half-way between the two.

    Args:
        scene: what is seen.
        rng: the source of randomness.
        part: of the observations.
        distances: the least and the largest from a point to the other one, metres.
    """
    tracks = scene.model.tracks
    pixels, points = np.array(tracks.pixels), np.array(tracks.points_world)
    for j in rng.choice(len(points), int(2 * part * len(points)), replace=False):
        seen = np.flatnonzero(tracks.point_index == j)
        bad = rng.choice(seen, len(seen) // 2, replace=False)
        away = rng.standard_normal(3)
        away *= rng.uniform(*distances) / np.linalg.norm(away) / scene.metres_per_world_unit
        camera_T_world = inverse(scene.world_T_camera[tracks.image_index[bad]])
        other = camera_T_world @ np.append(scene.points_world[j] + away, 1.0)
        pixels[bad] = project(scene.camera, other[:, :3])
        pixels[bad] += scene.noise.pixel * rng.standard_normal((len(bad), 2))
        points[j] += 0.5 * away
    return replace(tracks, pixels=pixels, points_world=points)
