"""The images that a reconstruction did not place: what hangs together of them, and why each is without pose."""

from collections.abc import Sequence
from pathlib import Path

import pycolmap

from handeye_fg.sfm.matching import matching_summary
from handeye_fg.sfm.model import FEWEST_IMAGES
from handeye_fg.types import Fragment

# Fewer inliers than this in its best pair: an image was not matched (COLMAP's least is 15).
_FEWEST_MATCHES = 15


def unplaced(
    reconstruction: pycolmap.Reconstruction, database: Path, names: Sequence[str]
) -> tuple[tuple[str, str], ...]:
    """(name, reason) of the images without pose.

    Args:
        reconstruction: the model.
        database: the one that it was made from.
        names: all images.
    """
    placed = {reconstruction.images[i].name for i in reconstruction.reg_image_ids()}
    summary = matching_summary(database)
    return tuple(
        (name, _reason(*summary.get(name, (0, 0)))) for name in sorted(names) if name not in placed
    )


def fragments_of(fragments: Sequence[Fragment], missing: Sequence[str]) -> tuple[Fragment, ...]:
    """Of overlapping fragments those that together hold the most of the missing images."""
    chosen: list[Fragment] = []
    left = set(missing)
    while fragments:
        best = max(fragments, key=lambda fragment: len(left.intersection(fragment.names)))
        if len(left.intersection(best.names)) < FEWEST_IMAGES:
            break
        left.difference_update(best.names)
        chosen.append(best)
    return tuple(chosen)


def _reason(n_features: int, n_matches: int) -> str:
    """Why an image has no pose, from its features and the inliers in its best pair."""
    if n_features == 0:
        return "no features found"
    if n_matches < _FEWEST_MATCHES:
        return (
            f"none of its {n_features} features matched another image's in a common geometry: it shows "
            "something else, or too little of the same"
        )
    return f"not enough matches in the scene's points ({n_matches} in its best pair)"
