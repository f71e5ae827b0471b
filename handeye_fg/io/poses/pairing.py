"""Which poses belong to which images: by name, by time, or, only if asked for, by number or order."""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import PurePosixPath

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import shown
from handeye_fg.io.poses.rows import Partners, PoseRows
from handeye_fg.options import PairBy, PoseFileOptions
from handeye_fg.types import Indices

SAME_INSTANT_NS = 1_000_000  # times are often printed in milliseconds

_NUMBER = re.compile(r"\d+(?:\.\d+)?", re.ASCII)
_TIME = re.compile(r"[+-]?(\d{1,19}([.,]\d{0,30})?|[.,]\d{1,30})([eE][+-]?\d{1,2})?", re.ASCII)
# Digits before the point of a time of our age in seconds, milliseconds, microseconds, nanoseconds.
_DIGITS_NS = ((11, 10**9), (14, 10**6), (17, 10**3), (999, 1))


def time_ns(text: str, tick_ns: int | None = None) -> int | None:
    """Nanoseconds from a time in the unit of ``tick_ns`` nanoseconds; None for what is no time.

    Without a unit it is told by the digits before the point: seconds have up to 11, milliseconds up to 14,
    microseconds up to 17.
    """
    if _TIME.fullmatch(text.strip()) is None:
        return None
    time = Decimal(text.strip().replace(",", "."))
    total = int(time * (tick_ns or _factor(str(abs(int(time))).lstrip("0"))))
    return total if abs(total) < 2**62 else None


def time_of_name(name: str) -> int | None:
    """The time in an image's name, nanoseconds: its last number, with a point or of 10 digits and more."""
    found = _NUMBER.findall(_stem(name))[-1:]
    if not found or ("." not in found[0] and len(found[0]) < 10):
        return None
    return time_ns(found[0])


def partners(rows: PoseRows, images: Sequence[str] | None, options: PoseFileOptions) -> Partners:
    """The rows for each image.

    Args:
        rows: of the file.
        images: names of the images, of several cameras with their folders; None: the rows name themselves.
        options: how to pair.

    Raises:
        InputDataError: the rows cannot be paired in this way, or only in one that must be asked for.
    """
    how = options.pair_by
    if how == "auto":
        how = _automatic(rows, images)
    if images is None:
        return _own_names(rows, how)
    # Images of several cameras with one name have one robot pose.
    files = sorted({PurePosixPath(image).name for image in images}, key=_natural)
    match how:
        case "name":
            return _by_name(rows, files)
        case "time" | "nearest-time":
            return _by_time(rows, files, options, nearest=how == "nearest-time")
        case "number":
            return _by_number(rows, files)
        case _:
            return _by_order(rows, files)


def _automatic(rows: PoseRows, images: Sequence[str] | None) -> PairBy:
    """By name or by time; never by order."""
    if rows.names is not None:
        return "name"
    if images is None:
        return "order" if rows.times_ns is None else "time"
    if rows.times_ns is not None and any(time_of_name(image) is not None for image in images):
        return "time"
    why = (
        "its rows have no image names"
        if rows.times_ns is None
        else f"its rows have times, but the images' names do not, such as {shown(images[0])}"
    )
    raise InputDataError(
        f"{rows.source}: {why}; write a column image, or say how the {len(rows.places)} rows and"
        f" {len(images)} images belong together: --pair-by number (the number in the image's name is the"
        " row's time, or counts the rows from 0) or --pair-by order"
    )


def _direct(names: Sequence[str], index: Sequence[int]) -> Partners:
    """One row for each name."""
    own = np.array(index, dtype=np.intp)
    return Partners(names=tuple(names), before=own, after=own, share=np.zeros(len(own)))


def _own_names(rows: PoseRows, how: PairBy) -> Partners:
    """Every row under its own name, its time or its number."""
    if rows.names is not None:
        names: Sequence[str] = rows.names
    elif rows.times_ns is not None and how in {"time", "nearest-time", "number"}:
        names = [f"{ns // 10**9}.{ns % 10**9:09d}" for ns in rows.times_ns.tolist()]
    elif how in {"order", "number"}:
        names = [f"row {i}" for i in range(len(rows.places))]
    else:
        raise _lacks(rows, "names", how)
    return _direct(names, range(len(names)))


def _by_name(rows: PoseRows, files: Sequence[str]) -> Partners:
    """By the image's name; rows with files of their own also by that name without suffix, or its number."""
    if rows.names is None:
        raise _lacks(rows, "image names", "name")
    if not rows.file_names:
        return _direct(rows.names, range(len(rows.names)))
    index = {name: i for i, name in enumerate(rows.names)}
    named = {file: index.get(file, index.get(_stem(file), -1)) for file in files}
    if all(i < 0 for i in named.values()):
        numbered = _unique_numbers(rows.names)
        of_images = _unique_numbers(files)
        named = {
            file: numbered.get(number, -1) for number, k in of_images.items() for file in [files[k]]
        }
    kept = {file: i for file, i in named.items() if i >= 0}
    if not kept:
        return _direct(rows.names, range(len(rows.names)))
    used = set(kept.values())
    others = {name: i for i, name in enumerate(rows.names) if i not in used}
    return _direct([*kept, *others], [*kept.values(), *others.values()])


def _by_time(
    rows: PoseRows, files: Sequence[str], options: PoseFileOptions, *, nearest: bool
) -> Partners:
    """Between the poses before and after each image in time, or the nearest one."""
    if rows.times_ns is None:
        raise _lacks(rows, "times", "time")
    order = _in_time(rows, rows.times_ns)
    times = rows.times_ns[order]
    tolerance = round(options.time_tolerance_s * 1e9)
    found: list[tuple[str, int, int, float]] = []
    closest: tuple[int, str] | None = None
    for file in files:
        moment = time_of_name(file)
        if moment is None:
            continue
        k = int(np.searchsorted(times, moment))
        after, before = min(k, len(times) - 1), max(k - 1, 0)
        gaps = abs(int(times[before]) - moment), abs(int(times[after]) - moment)
        near = before if gaps[0] <= gaps[1] else after
        closest = min(closest or (min(gaps), file), (min(gaps), file))
        if times[after] == moment:
            found.append((file, after, after, 0.0))
        elif not nearest and before < k <= after and max(gaps) <= tolerance:
            found.append((file, before, after, gaps[0] / sum(gaps)))
        elif min(gaps) <= (tolerance if nearest else SAME_INSTANT_NS):
            found.append((file, near, near, 0.0))
    if not found:
        gap = "no image has a time in its name"
        if closest is not None:
            gap = f"the nearest are {closest[0] / 1e9:.6g} s apart, at {shown(closest[1])}"
        raise InputDataError(
            f"{rows.source}: no image has its time between two poses that are both within"
            f" {options.time_tolerance_s:g} s of it ({gap}); check the clocks, or give a larger"
            " --time-tolerance-s, or --pair-by nearest-time if the arm stood still"
        )
    names, before_rows, after_rows, share = zip(*found, strict=True)
    return Partners(
        names=names,
        before=order[list(before_rows)],
        after=order[list(after_rows)],
        share=np.array(share),
    )


def _in_time(rows: PoseRows, times: Indices) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """The rows in the order of their times, each time once."""
    order = np.argsort(times, kind="stable")
    kept = [int(order[0])]
    for i in order[1:].tolist():
        if times[i] != times[kept[-1]]:
            kept.append(i)
            continue
        same = np.array_equal(rows.positions[i], rows.positions[kept[-1]]) and np.array_equal(
            rows.rotations[i], rows.rotations[kept[-1]]
        )
        if not same:
            raise InputDataError(
                f"{rows.places[i]}: another pose has the same time; remove one of the two rows"
            )
    return np.array(kept, dtype=np.intp)


def _by_number(rows: PoseRows, files: Sequence[str]) -> Partners:
    """The last number in an image's name is the row's time or number, or that in its file's name."""
    images = _unique_numbers(files)
    if len(images) < len(files):
        raise InputDataError(
            f"{rows.source}: to pair by number, each image's name needs a number of its own at its end, but"
            f" {len(files) - len(images)} of {len(files)} have none or share it; rename the images"
        )
    if rows.file_names and rows.names is not None:
        numbered = _unique_numbers(rows.names)
    elif rows.times_ns is not None:
        numbered = {
            ns // 10**9: i for i, ns in enumerate(rows.times_ns.tolist()) if ns % 10**9 == 0
        }
    else:
        numbered = {i: i for i in range(len(rows.places))}
        beyond = [number for number in images if number not in numbered]
        if beyond:
            raise InputDataError(
                f"{rows.source}: its {len(numbered)} rows have the numbers 0 to {len(numbered) - 1}, but"
                f" there is an image {shown(files[images[beyond[0]]])}; add the missing rows, rename the"
                " images, or pair by order"
            )
    both = [number for number in images if number in numbered]
    if not both:
        raise InputDataError(
            f"{rows.source}: no row has the number of an image, such as {shown(files[0])}; check the numbers"
        )
    return _direct(
        [files[images[number]] for number in both], [numbered[number] for number in both]
    )


def _by_order(rows: PoseRows, files: Sequence[str]) -> Partners:
    """The sorted images one by one; as many as there are rows."""
    if len(files) != len(rows.places):
        raise InputDataError(
            f"{rows.source}: {len(rows.places)} poses cannot be paired with {len(files)} images by order;"
            " give as many of each"
        )
    return _direct(files, range(len(files)))


def _unique_numbers(names: Sequence[str]) -> dict[int, int]:
    """Which name has a number at its end, for the numbers that one name alone has."""
    found: dict[int, list[int]] = {}
    for i, name in enumerate(names):
        digits = re.search(r"(\d{1,18})\D*$", _stem(name), re.ASCII)
        if digits:
            found.setdefault(int(digits[1]), []).append(i)
    return {number: index[0] for number, index in found.items() if len(index) == 1}


def _lacks(rows: PoseRows, what: str, how: str) -> InputDataError:
    return InputDataError(
        f"{rows.source}: its rows have no {what}, which --pair-by {how} needs; choose another --pair-by"
    )


def _factor(digits: str) -> int:
    """Nanoseconds in the unit of a time with these digits before the point."""
    return next(factor for most, factor in _DIGITS_NS if len(digits) <= most)


def _stem(name: str) -> str:
    """A file's name without its suffix; what follows a decimal point is none."""
    path = PurePosixPath(name)
    return path.stem if re.search("[A-Za-z]", path.suffix) else path.name


def _natural(name: str) -> list[tuple[int, int, str]]:
    """A key that sorts frame_2 before frame_10."""
    parts = re.split(r"(\d{1,18})", name, flags=re.ASCII)
    return [(1, int(part), "") if i % 2 else (0, 0, part) for i, part in enumerate(parts)]
