"""How features are searched for: time against accuracy; entry point ``effort_of``."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from handeye_fg.options import SfmOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """What the search for features may cost.

    Attributes:
        max_features: most features kept in an image, those of the largest scale.
        first_octave: -1: the image is enlarged to twice its size first, for the smallest features.
    """

    max_features: int
    first_octave: int


# The figures are in benchmarks/README.md.
EFFORTS: Mapping[str, Effort] = MappingProxyType(
    {
        "fast": Effort(max_features=4096, first_octave=0),
        "normal": Effort(max_features=4096, first_octave=-1),
        "thorough": Effort(max_features=8192, first_octave=-1),
    }
)
# Of so few, each counts: an image with little texture keeps its place.
_FEW_IMAGES = 16


def effort_of(options: SfmOptions, n_images: int) -> Effort:
    """The effort that the options ask for."""
    automatic = "thorough" if n_images <= _FEW_IMAGES else "normal"
    effort = EFFORTS[automatic if options.preset == "auto" else options.preset]
    if options.max_features is None:
        return effort
    return replace(effort, max_features=options.max_features)
