"""Results that earlier versions wrote: keys that their files do not have yet are read as unknown.

Entry points: ``completed`` for a document, ``may_lack`` for a place in it.
"""

import re
from collections.abc import Mapping
from collections.abc import Set as AbstractSet

# What is read where an earlier version wrote no such key: null is unknown. Features were taken to err
# independently before there was a factor for those that err alike.
_OF_INTRINSICS = {"other": None, "focal_offset": None, "correlation": None}
_OF_LEVEL = {"found": None}
_LATER: Mapping[str, Mapping[str, object]] = {
    "noise": {"image_inflation": 1.0, "corner_px": None},
    "images[]": dict.fromkeys(
        ("w_test", "influence_rotation_deg", "influence_translation_mm", "std_growth")
    ),
    "intrinsics": _OF_INTRINSICS,
    "cameras[].intrinsics": _OF_INTRINSICS,
    "holdout": {"expected_reprojection_px": None, "within_95": None, "new_images": False},
    "holdout.images[]": {"expected_reprojection_px": None},
    "certainty.noise.pixel_px": _OF_LEVEL,
    "certainty.noise.robot_rotation_deg": _OF_LEVEL,
    "certainty.noise.robot_translation_mm": _OF_LEVEL,
    "certainty.noise.corner_px": _OF_LEVEL,
}
# Places that lead to one of these; others are not looked into, however deep they are.
_LEADING = {path[:end] for path in _LATER for end in range(len(path) + 1)}


def completed(document: object, path: str = "") -> object:
    """A document with the keys that earlier versions did not write.

    Args:
        document: ``result.json``, parsed, or a part of it.
        path: where that part is.
    """
    if path not in _LEADING:
        return document
    if isinstance(document, list):
        return [completed(item, f"{path}[]") for item in document]
    if isinstance(document, dict):
        found = {name: completed(value, _below(path, name)) for name, value in document.items()}
        return {**_LATER.get(path, {}), **found}
    return document


def may_lack(path: str) -> AbstractSet[str]:
    """The keys that a document may lack at a place such as ``images[3]``."""
    return _LATER.get(re.sub(r"\[\d+\]", "[]", path), {}).keys()


def _below(path: str, name: object) -> str:
    return f"{path}.{name}" if path else str(name)
