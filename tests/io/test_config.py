from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handeye_fg.errors import InputDataError
from handeye_fg.io import config
from handeye_fg.io.config import options_digest, read_config, write_config
from handeye_fg.options import Options
from handeye_fg.priors import DistancePrior, PosePrior, Prior

POSITIVE = st.floats(1e-6, 1e6)
AXIS = st.tuples(POSITIVE, POSITIVE, POSITIVE)
quick = settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "run.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner:
    ratio: float = 0.5
    name: str | None = None

    def __post_init__(self) -> None:
        if self.ratio < 0.0:
            raise ValueError(f"ratio is {self.ratio}, but must not be negative")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outer:
    flag: bool = False
    count: int = 3
    mode: Literal["a", "b", 1] = "a"
    limits: tuple[float, ...] = (1.0, 2.0)
    words: tuple[str, ...] | None = None
    inner: Inner = field(default_factory=Inner)


def valid(hint: Any) -> st.SearchStrategy[Any]:
    """Values that suit an annotation: finite, positive."""
    if hint is Prior:
        return st.builds(Prior, st.just("translation-along"), AXIS, st.floats(-1, 1), POSITIVE)
    if hint is PosePrior:
        return st.builds(
            PosePrior, AXIS, st.tuples(*[POSITIVE] * 4), POSITIVE, st.none() | POSITIVE
        )
    if hint is DistancePrior:
        names = st.permutations(["a.jpg", "b/ä.jpg", 'c"\\.jpg'])
        return st.builds(DistancePrior, names.map(lambda n: tuple(n[:2])), POSITIVE, POSITIVE)
    if is_dataclass(hint) and isinstance(hint, type):
        given = {k: valid(v) for k, v in get_type_hints(hint).items()}
        if hint is Options:
            given["holdout"] = st.floats(0.0, 0.5)
        return st.builds(hint, **given)
    if get_origin(hint) in (Union, UnionType):
        return st.one_of(*map(valid, get_args(hint)))
    if get_origin(hint) is tuple:
        return st.lists(valid(get_args(hint)[0]), max_size=3).map(tuple)
    if hint is float:
        return POSITIVE
    return st.integers(1, 10**6) if hint is int else st.from_type(hint)


@pytest.fixture
def outer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "Options", Outer)


@quick
@given(valid(Options))
def test_round_trip_of_the_options(tmp_path: Path, options: Options) -> None:
    path = write_config(options, tmp_path / "out" / "config.toml")
    assert read_config(path) == options
    assert options_digest(read_config(path)) == options_digest(options)


@pytest.mark.usefixtures("outer")
@quick
@given(valid(Outer))
def test_round_trip_of_every_kind_of_option(tmp_path: Path, options: Any) -> None:
    assert read_config(write_config(options, tmp_path / "config.toml")) == options


def test_what_is_left_out_has_its_default(tmp_path: Path) -> None:
    assert read_config(written(tmp_path, "")) == Options()
    assert read_config(written(tmp_path, "seed = 7")) == Options(seed=7)
    assert "pixel_px" not in write_config(Options(), tmp_path / "c.toml").read_text()


@pytest.mark.usefixtures("outer")
def test_integers_serve_as_numbers(tmp_path: Path) -> None:
    options: Any = read_config(written(tmp_path, "limits = [3]\n[inner]\nratio = 1"))
    assert options == Outer(limits=(3.0,), inner=Inner(ratio=1.0))
    assert type(options.inner.ratio) is float


def test_digest_depends_on_values_only() -> None:
    assert options_digest(Options()) == options_digest(Options(seed=0))
    assert options_digest(Options()) != options_digest(Options(seed=1))


def test_digest_does_not_depend_on_how_a_number_is_written() -> None:
    one: Any = Inner(ratio=1)
    other: Any = Inner(ratio=1.0)
    assert options_digest(one) == options_digest(other)


@pytest.mark.usefixtures("outer")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = ", r"not valid TOML \(Invalid value"),
        ("count = " + "9" * 5000, "not valid TOML"),
        ("words = " + "[" * 50_000, "not valid TOML"),
        (b"\xff", "byte 0 is not UTF-8"),
        ("depth = 3", "depth is not an option, but one of flag, count, mode, limits, words, inner"),
        ("[inner]\nrate = 3", "inner.rate is not an option, but one of ratio, name was expected"),
        ("count = true", "count is True, but must be an integer"),
        ("count = 3.0", "count is 3.0, but must be an integer"),
        ("flag = 1", "flag is 1, but must be true or false"),
        ("mode = 'c'", "mode is 'c', but must be one of 'a', 'b', 1"),
        ("mode = true", "mode is True, but must be one of 'a', 'b', 1"),
        ("mode = []", r"mode is \[\], but must be one of"),
        ("limits = 3", "limits is 3, but must be an array"),
        ("limits = [1, 'x']", r"limits\[1\] is 'x', but must be a finite number"),
        ("inner = 3", "inner is 3, but must be a table"),
        ("[inner]\nratio = nan", "inner.ratio is nan, but must be a finite number"),
        ("[inner]\nratio = 1979-05-27", "inner.ratio is .*1979.*, but must be a finite number"),
        ("[inner]\nratio = 0x" + "f" * 5000, "ratio is an integer of 20000 bits, but must be a fi"),
        ("[inner]\nname = 3", "inner.name is 3, but must be a string"),
        ("[inner]\nratio = -1", "inner: ratio is -1.0, but must not be negative"),
    ],
)
def test_errors_name_key_value_and_wanted(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(InputDataError, match=f"^config file .*run.toml: .*{message}"):
        read_config(written(tmp_path, text))


def test_options_of_an_unknown_kind_are_a_programmer_s_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @dataclass(frozen=True)
    class Odd:
        value: complex = 0j

    monkeypatch.setattr(config, "Options", Odd)
    with pytest.raises(TypeError, match=r"option value: the annotation .*complex"):
        read_config(written(tmp_path, "value = 1"))


@quick
@given(st.one_of(st.binary(max_size=100), st.text(max_size=100).map(str.encode)))
def test_nothing_but_input_data_errors(tmp_path: Path, content: bytes) -> None:
    try:
        options = read_config(written(tmp_path, content))
    except InputDataError:
        return
    assert options == Options()
