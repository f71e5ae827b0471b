"""The Python interface: every name documented, every example run, every command there as a function."""

import doctest
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from types import ModuleType
from typing import Any, get_args, get_type_hints

import cv2
import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg import frames
from handeye_fg.commands import COMMANDS
from handeye_fg.io.image_arrays import as_folder
from handeye_fg.io.images import list_cameras, read_image_set
from handeye_fg.simulate import simulate_scene

FUNCTIONS = [name for name in hf.__all__ if inspect.isfunction(getattr(hf, name))]
# Commands whose function has another name.
FUNCTION_OF = {"report": "render_report", "simulate": "write_scene"}


def modules() -> list[ModuleType]:
    return [
        importlib.import_module(found.name)
        for found in pkgutil.walk_packages(hf.__path__, "handeye_fg.")
        if found.name != "handeye_fg.__main__"
    ]


EXAMPLES = [
    pytest.param(test, id=test.name)
    for module in modules()
    for test in doctest.DocTestFinder(exclude_empty=True).find(module)
    if test.examples and (test.globs.get("__name__") == module.__name__)
]


@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_run(example: doctest.DocTest) -> None:
    """Each says by itself what it needs: no name of its module is there."""
    example.globs = {}
    lines: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    runner.run(example, out=lines.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(lines)


def test_there_are_examples() -> None:
    names = {str(parameter.id).rsplit(".", 1)[-1] for parameter in EXAMPLES}
    assert {getattr(hf, name).__name__ for name in FUNCTIONS} <= names


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_documented(name: str) -> None:
    function: Any = getattr(hf, name)
    text = inspect.getdoc(function) or ""
    hints = function.__annotations__
    for parameter in inspect.signature(function).parameters:
        assert re.search(rf"^ +(\w+, )*\*{{0,2}}{parameter}(, \w+)*: ", text, re.MULTILINE), (
            parameter
        )
        assert parameter in hints
    assert "return" in hints
    assert text.splitlines()[0].endswith(".")


@pytest.mark.parametrize("name", hf.__all__)
def test_names_are_documented(name: str) -> None:
    assert len(inspect.getdoc(getattr(hf, name)) or "") > 10


def classes_in(hint: Any) -> Iterator[type]:
    """The classes of this package that a type consists of."""
    if inspect.isclass(hint) and hint.__module__.startswith("handeye_fg."):
        yield hint
    for part in get_args(hint):
        yield from classes_in(part)


def test_what_functions_take_is_public_as_well() -> None:
    """But for what ``read_arm`` and ``handeye_fg.simulate`` give."""
    takers = [
        getattr(hf, name) for name in FUNCTIONS if name != "export"
    ]  # pycolmap's for checkers only
    takers += [getattr(hf, name) for name in hf.__all__ if name.endswith("Options")]
    taken = {
        kind.__name__
        for taker in takers
        for parameter, hint in get_type_hints(taker).items()
        if parameter != "return"
        for kind in classes_in(hint)
    }
    assert taken - set(hf.__all__) == {"Reach", "Scene"}


def test_each_command_is_a_function() -> None:
    for command in COMMANDS:
        assert FUNCTION_OF.get(command, command) in FUNCTIONS


def test_images_as_arrays_are_files_without_loss() -> None:
    rng = np.random.default_rng(0)
    colour = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
    images = {
        "cam0/a.jpg": colour,
        "cam1/a.png": colour[:, :, 0],
        "cam1/b.tif": colour[:, :, 1] > 9,
    }
    with as_folder(images) as folder:
        assert list_cameras(folder) == tuple(images)
        assert read_image_set(folder, ["cam0/a.jpg"]).size == (64, 48)
        assert np.array_equal(cv2.imread(str(folder / "cam0/a.jpg"))[:, :, ::-1], colour)
        mask = cv2.imread(str(folder / "cam1/b.tif"), cv2.IMREAD_GRAYSCALE)
        assert np.array_equal(mask, np.where(colour[:, :, 1] > 9, 255, 0))
    assert not folder.exists()
    with as_folder({"a.jpg": colour[:, :, 0]}, ".png") as folder:
        assert [path.name for path in folder.iterdir()] == ["a.jpg.png"]
    with as_folder("somewhere") as folder:
        assert str(folder) == "somewhere"


@pytest.mark.parametrize(
    ("name", "pixels", "message"),
    [
        ("../a.png", np.zeros((4, 4), np.uint8), "leads out of the image folder"),
        ("a.csv", np.zeros((4, 4), np.uint8), "'a.csv' does not end in .bmp"),
        ("a.png", np.zeros((4, 4)), "an array of float64 and shape .4, 4., but must be uint8"),
        ("a.png", np.zeros((4, 4, 4), np.uint8), "shape .4, 4, 4., but must be"),
        ("a.png", np.zeros((0, 4), np.uint8), "shape .0, 4., but must be"),
        ("a.png", "pixels", "an array of <U6"),
    ],
)
def test_arrays_that_are_no_images(name: str, pixels: Any, message: str) -> None:
    with pytest.raises(hf.InputDataError, match=message), as_folder({name: pixels}):
        pass


def test_a_model_of_arrays() -> None:
    """Everything from structure from motion on, without a file and without COLMAP."""
    scene = simulate_scene(np.random.default_rng(2), n_images=10, n_points=80)
    tracks = hf.Tracks(
        points_world=scene.model.tracks.points_world,
        image_index=scene.model.tracks.image_index,
        point_index=scene.model.tracks.point_index,
        pixels=scene.model.tracks.pixels,
    )
    model = hf.SfmModel(
        names=scene.model.names,
        world_T_camera=scene.model.world_T_camera,
        cameras=(scene.camera,),
        image_camera=np.zeros(10, dtype=int),
        tracks=tracks,
        mean_reprojection_px=0.3,
        unregistered=(),
    )
    result = hf.refine(model, scene.robot_poses)
    error = frames.log(frames.inverse(result.matrix) @ scene.gripper_T_camera)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.1
    assert np.linalg.norm(error[3:]) < 1e-3
