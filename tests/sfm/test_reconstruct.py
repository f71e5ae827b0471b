"""A few small images through all of structure from motion."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw
from scipy.spatial.transform import Rotation

import tabletop
from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.options import Pairs, SfmOptions
from handeye_fg.progress import Progress, silent
from handeye_fg.sfm import RobotGuide, read_model, reconstruct
from handeye_fg.turns import RobotTurns
from handeye_fg.types import CameraModel, SfmModel
from tabletop import HALF_CAMERA as CAMERA
from tabletop import TRUTH

pytestmark = pytest.mark.e2e

N_IMAGES = 5
NAMES = tabletop.NAMES[:N_IMAGES]


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("images")
    tabletop.save_halves(folder, N_IMAGES + 1)
    return folder


def run(
    images: Path,
    folder: Path,
    *,
    names: tuple[str, ...] = NAMES,
    camera: CameraModel | None = CAMERA,
    masks: Path | None = None,
    progress: Progress = silent,
    turns: RobotTurns | None = None,
    guide: RobotGuide | None = None,
    pairs: Pairs = "auto",
) -> SfmModel:
    return reconstruct(
        images,
        names,
        None if camera is None else {".": camera},
        masks=masks,
        folder=folder,
        options=SfmOptions(max_features=2000, pairs=pairs),
        seed=0,
        progress=progress,
        turns=turns,
        guide=guide,
    )


@pytest.fixture(scope="module")
def first(images: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[SfmModel, Path, list]:
    folder = tmp_path_factory.mktemp("out") / "sfm"
    told: list[tuple[str, int, int | None]] = []
    return run(images, folder, progress=lambda *report: told.append(report)), folder, told


def test_poses_agree_with_the_truth(first: tuple[SfmModel, Path, list]) -> None:
    model, _, _ = first
    assert model.names == NAMES
    assert model.unregistered == ()
    np.testing.assert_array_equal(model.camera.params, CAMERA.params)
    assert model.mean_reprojection_px < 1.0
    # Some 100 matches of 0.5 px at 550 px give 0.01 degrees; five times that, for their geometry.
    assert largest_error_deg(model) < 0.05


def largest_error_deg(model: SfmModel) -> float:
    """Of the images' turns from the first one."""
    base_T_camera = TRUTH["base_T_gripper"][:N_IMAGES] @ TRUTH["gripper_T_camera"]
    theirs = base_T_camera[:, :3, :3].transpose(0, 2, 1) @ base_T_camera[:1, :3, :3]
    ours = model.world_T_camera[:, :3, :3].transpose(0, 2, 1) @ model.world_T_camera[:1, :3, :3]
    angles = Rotation.from_matrix(ours @ theirs.transpose(0, 2, 1)).magnitude()
    return float(np.rad2deg(angles).max())


def true_turns() -> RobotTurns:
    return RobotTurns(rotations=TRUTH["base_T_gripper"][:N_IMAGES, :3, :3], setup="eye-in-hand")


def test_text_over_every_image_is_left_out(images: Path, tmp_path: Path) -> None:
    for name in NAMES:
        with Image.open(images / name) as image:
            draw = ImageDraw.Draw(image)
            for row in range(6):
                line = f"{row} POSE 12.34 567.8 -90.1 QWERTZ #{row * 7} @ 0.5 m/s"
                draw.text((20, 30 + 24 * row), line, fill="yellow", font_size=20)
            image.save(tmp_path / name, quality=95)
    model = run(tmp_path, tmp_path / "sfm", turns=true_turns())
    assert model.names == NAMES
    assert 0.03 < model.static_share < 0.5
    # None of what is left lies on the text but where the scene shines through.
    x, y = model.tracks.pixels.T
    assert np.mean((x > 20) & (x < 400) & (y > 30) & (y < 170)) < 0.05
    again = run(tmp_path, tmp_path / "sfm", turns=true_turns())
    assert again.static_share == model.static_share
    np.testing.assert_array_equal(again.world_T_camera, model.world_T_camera)


def test_the_fingers_of_the_gripper_are_left_out(images: Path, tmp_path: Path) -> None:
    """Textured, in changing light, and not quite at the same pixel: they shake."""
    rng = np.random.default_rng(0)
    corners = [(60, 480), (110, 250), (190, 240), (220, 480)], [(430, 480), (460, 240), (600, 480)]
    coarse = Image.fromarray(rng.integers(0, 256, (80, 107, 3)).astype(np.uint8))
    texture = np.asarray(coarse.resize((640, 480), Image.Resampling.BICUBIC), dtype=np.float64)
    for name in NAMES:
        outline = Image.new("L", (640, 480))
        shake = rng.normal(0.0, 0.3, 2)
        for polygon in corners:
            ImageDraw.Draw(outline).polygon(polygon, fill=255)
        across = np.sin(np.linspace(0.0, 4.0, 640) + rng.uniform(0.0, 6.0))
        light = rng.uniform(0.7, 1.1) * (1.0 + 0.2 * across)
        painted = Image.fromarray(np.clip(texture * light[:, None], 0, 255).astype(np.uint8))
        moved = (1.0, 0.0, shake[0], 0.0, 1.0, shake[1])
        painted = painted.transform(
            (640, 480), Image.Transform.AFFINE, moved, Image.Resampling.BICUBIC
        )
        with Image.open(images / name) as image:
            image.paste(painted, mask=outline)
            image.save(tmp_path / name, quality=92)
    model = run(tmp_path, tmp_path / "sfm", turns=true_turns())
    assert model.names == NAMES
    assert 0.1 < model.static_share < 0.5
    finger = np.asarray(outline)[tuple(model.tracks.pixels.astype(int).T[::-1])] > 0
    assert finger.mean() < 0.01
    assert largest_error_deg(model) < 0.3


def test_each_folder_has_a_camera(images: Path, tmp_path: Path) -> None:
    """Of its own size and intrinsics: the second folder holds the images at three quarters."""
    small = replace(CAMERA, width=480, height=360, params=CAMERA.params * np.repeat([0.75, 1.0], 4))
    names = tuple(f"cam{int(i > 2)}/{name}" for i, name in enumerate(NAMES))
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        with Image.open(images / Path(name).name) as image:
            camera = small if name.startswith("cam1") else CAMERA
            resized = image.resize((camera.width, camera.height), Image.Resampling.BOX)
            resized.save(tmp_path / name, quality=95)
    model = reconstruct(
        tmp_path,
        names,
        {"cam0": CAMERA, "cam1": small},
        masks=None,
        folder=tmp_path / "sfm",
        options=SfmOptions(max_features=2000),
        seed=0,
        progress=silent,
    )
    assert model.names == names
    assert model.image_camera.tolist() == [0, 0, 0, 1, 1]
    for found, given in zip(model.cameras, (CAMERA, small), strict=True):
        assert (found.width, found.height) == (given.width, given.height)
        np.testing.assert_array_equal(found.params, given.params)
    # Resampled twice; with the other folder's intrinsics it would be degrees.
    assert largest_error_deg(model) < 0.2


def test_the_robot_may_choose_the_pairs(
    images: Path, first: tuple[SfmModel, Path, list], tmp_path: Path
) -> None:
    """Of five images all: the same model, whether the robot is sure or not."""
    asked: list[SfmModel] = []

    def place(models: Sequence[SfmModel]) -> tuple[SfmModel, np.ndarray]:
        asked.extend(models)
        return models[0], models[0].world_T_camera

    poses = TRUTH["base_T_gripper"][:N_IMAGES]
    model = run(
        images, tmp_path / "sfm", guide=RobotGuide(base_T_gripper=poses, place=place), pairs="robot"
    )
    assert [model.names for model in asked] == [NAMES]
    np.testing.assert_allclose(model.world_T_camera, first[0].world_T_camera, atol=1e-3)
    # The poses are among what the model depends on.
    other = RobotGuide(base_T_gripper=poses[::-1], place=lambda _: None)
    told: list[str] = []
    run(
        images,
        tmp_path / "sfm",
        guide=other,
        pairs="robot",
        progress=lambda stage, *_: told.append(stage),
    )
    assert "pairs" in told


def test_progress_is_counted(first: tuple[SfmModel, Path, list]) -> None:
    _, _, told = first
    last = {stage: (done, total) for stage, done, total in told}
    assert last == {"features": (5, 5), "pairs": (10, 10), "registered": (5, 5)}


def test_an_unchanged_run_reuses_the_model(
    images: Path, first: tuple[SfmModel, Path, list]
) -> None:
    model, folder, _ = first
    since = time.monotonic()
    again = run(images, folder)
    assert time.monotonic() - since < 2
    np.testing.assert_array_equal(again.world_T_camera, model.world_T_camera)
    assert (folder / "database.db").is_file()
    assert read_model(folder).names == model.names


def test_a_repeated_run_finds_the_same(
    images: Path, first: tuple[SfmModel, Path, list], tmp_path: Path
) -> None:
    again = run(images, tmp_path / "sfm")
    np.testing.assert_array_equal(again.world_T_camera, first[0].world_T_camera)


def test_without_a_camera_the_intrinsics_are_found(images: Path, tmp_path: Path) -> None:
    model = run(images, tmp_path / "sfm", camera=None)
    assert model.camera.model == "OPENCV"
    assert len(model.names) == 5
    # Five views determine the focal length to some percent.
    assert model.camera.params[:2] == pytest.approx([550, 550], rel=0.1)


def test_a_folded_camera_file_is_replaced_by_its_opencv_fit(images: Path, tmp_path: Path) -> None:
    params = np.array([*CAMERA.params, -2.5, 0.0, 0.0, 0.0])
    folded = replace(CAMERA, model="FULL_OPENCV", params=params)
    model = run(images, tmp_path / "sfm", camera=folded)
    assert model.camera.model == "OPENCV"
    assert len(model.names) == 5
    assert model.camera.params[:2] == pytest.approx([550, 550], rel=0.3)


def test_an_image_that_shows_something_else_is_named(images: Path, tmp_path: Path) -> None:
    for name in NAMES:
        (tmp_path / name).write_bytes((images / name).read_bytes())
    Image.new("RGB", (640, 480), "grey").save(tmp_path / "blank.png")
    model = run(tmp_path, tmp_path / "out" / "sfm", names=(*NAMES, "blank.png"))
    assert model.unregistered == (("blank.png", "no features found"),)
    assert model.names == NAMES


def test_images_without_texture_are_refused_with_a_remedy(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    names = tuple(f"{i}.png" for i in range(3))
    for name in names:
        Image.new("RGB", (640, 480), "grey").save(tmp_path / name)
    with pytest.raises(ReconstructionError, match=r"placed 0 of 3 images.*more textured"):
        run(tmp_path, tmp_path / "out" / "sfm", names=names)
    assert not (tmp_path / "out" / "sfm").exists()
    assert capfd.readouterr().err == ""


def test_an_all_black_mask_leaves_nothing(images: Path, tmp_path: Path) -> None:
    for name in NAMES:
        Image.new("L", (640, 480), 0).save(tmp_path / f"{name}.png")
    with pytest.raises(ReconstructionError, match="placed 0 of 5"):
        run(images, tmp_path / "sfm", masks=tmp_path)


@pytest.mark.parametrize("stage", ["features", "pairs", "registered"])
def test_an_interrupt_stops_within_seconds_and_leaves_no_half_model(
    images: Path, tmp_path: Path, stage: str
) -> None:
    """Seconds of computing: how long they take depends on what else the machine does."""
    since: list[float] = []

    def interrupt(name: str, done: int, _total: int | None) -> None:
        if name == stage and done >= 1:
            since.append(time.process_time())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(images, tmp_path / "out" / "sfm", progress=interrupt)
    assert time.process_time() - since[0] < 3
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["stages"]
    assert not list((tmp_path / "out" / "stages").glob(".*"))


def test_a_folder_of_someone_else_is_refused_before_any_work(images: Path, tmp_path: Path) -> None:
    (tmp_path / "sfm").mkdir()
    (tmp_path / "sfm" / "notes.txt").touch()
    with pytest.raises(InputDataError, match="not written by handeye-fg"):
        run(images, tmp_path / "sfm")
