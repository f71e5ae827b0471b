"""Priors as words of the command line."""

import pytest
import tyro

from handeye_fg.options import Options


def test_priors_of_every_kind_are_read() -> None:
    words = {
        "translation-along": (["0,0,1", "0.08", "0.001"], {"axis": (0.0, 0.0, 1.0), "std": 0.001}),
        "pose": (["0,0,-0.1,0,0,0,1", "0.5", "-"], {"std_translation_mm": None}),
        "scale": (["0.25", "0.01"], {"value": 0.25}),
        "intrinsics": (["0.2", "3"], {"focal_percent": 0.2, "centre_px": 3.0}),
        "distance": (["a.jpg", "b.jpg", "0.25", "0.001"], {"images": ("a.jpg", "b.jpg")}),
    }
    flags = [word for kind, (rest, _) in words.items() for word in ("--prior", kind, *rest)]
    given = tyro.cli(Options, args=flags)
    assert [prior.kind for prior in given.priors] == list(words)
    for prior, (_, fields) in zip(given.priors, words.values(), strict=True):
        for name, value in fields.items():
            assert getattr(prior, name) == value
    # Written as the default of another call, they are read the same.
    assert tyro.cli(Options, default=given, args=[]) == given


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["mass", "1", "2"], "must be one of translation-along, pose"),
        (["scale", "0.25"], "is written scale METRES_PER_WORLD_UNIT STD"),
        (["pose", "0,0,0.1", "0.5", "1"], "must be four numbers"),
        (["distance", "a", "a", "1", "1"], "two different names"),
    ],
)
def test_priors_that_are_no_priors_are_told(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        tyro.cli(Options, args=["--prior", *words])
    assert stop.value.code == 2
    assert message in " ".join(capsys.readouterr().err.replace("│", " ").split())
