import pytest

from handeye_fg.options import GraphOptions, NoiseOptions, SfmOptions


@pytest.mark.parametrize(
    ("block", "name", "value"),
    [
        (SfmOptions, "max_features", 0),
        (SfmOptions, "threads", -1),
        (NoiseOptions, "pixel_px", 0.0),
        (NoiseOptions, "robot_rotation_deg", -0.1),
        (NoiseOptions, "robot_translation_mm", float("nan")),
        (NoiseOptions, "robot_translation_mm", float("inf")),
        (GraphOptions, "max_iterations", 0),
    ],
)
def test_values_out_of_range_are_refused_by_name(block, name, value):
    with pytest.raises(ValueError, match=rf"{name} is {value}, but must be"):
        block(**{name: value})
