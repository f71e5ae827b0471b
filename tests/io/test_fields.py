from handeye_fg.io.fields import reason, shown


def test_shown_values_are_bounded_and_on_one_line() -> None:
    assert shown("a\nb") == r"'a\nb'"
    assert shown(1.5) == "1.5"
    assert shown(0) == "0"
    for value in ("x" * 10**6, [[[["x" * 100] * 100] * 100] * 100] * 100, 10**10_000, b"x" * 10**6):
        assert len(shown(value)) < 1500


def test_reasons_are_bounded_and_on_one_line() -> None:
    assert reason(ValueError("a\n  b")) == "a b"
    assert reason(EOFError()) == "EOFError"
    assert reason(ValueError("x" * 1000)) == "x" * 200 + "..."
