"""The gripper's own fingers in every image, without masks: found, left out, and told."""

from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

import handeye_fg as hf
from handeye_fg import frames
from handeye_fg.options import SfmOptions
from tabletop import HALF_CAMERA, TABLETOP, TRUTH
from tabletop import HALF_SIZE as SIZE

pytestmark = pytest.mark.e2e

N_IMAGES = 8
# Two fingers that hold a part between them: a third of the view.
OUTLINES = (
    [(0.05, 1.0), (0.12, 0.4), (0.36, 0.4), (0.4, 1.0)],
    [(0.62, 1.0), (0.66, 0.4), (0.9, 0.4), (0.98, 1.0)],
)


def inside() -> NDArray[np.uint8]:
    """255 where the fingers are."""
    outline = np.zeros(SIZE[::-1], np.uint8)
    for polygon in OUTLINES:
        cv2.fillPoly(outline, [(np.array(polygon) * SIZE).astype(int)], 255)
    return outline


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The set with fingers painted in, in changing light, shaking by a fifth of a pixel."""
    folder, rng = tmp_path_factory.mktemp("fingers"), np.random.default_rng(0)
    coarse = rng.integers(0, 256, (SIZE[1] // 6, SIZE[0] // 6, 3)).astype(np.float32)
    texture = cv2.resize(coarse, SIZE, interpolation=cv2.INTER_CUBIC)
    for path in sorted((TABLETOP / "images").iterdir())[:N_IMAGES]:
        whole = cv2.imread(str(path))
        assert whole is not None
        image = cv2.resize(whole, SIZE, interpolation=cv2.INTER_AREA)
        shake = np.column_stack([np.eye(2), rng.normal(0.0, 0.2, 2)])
        finger = cv2.warpAffine(rng.uniform(0.7, 1.1) * texture, shake, SIZE)
        share = cv2.warpAffine(inside(), shake, SIZE)[..., None] / 255.0
        mixed = np.clip(image * (1.0 - share) + finger * share, 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / path.name), mixed, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return folder


def test_they_are_left_out_by_default(images: Path, tmp_path: Path) -> None:
    result = hf.calibrate(
        images,
        hf.read_poses(TABLETOP / "poses.csv"),
        HALF_CAMERA,
        options=hf.Options(sfm=SfmOptions(preset="fast", threads=1)),
        output=tmp_path,
    )
    assert "of the features stayed at their pixel while the robot turned" in result.message
    assert [image.name for image in result.images if image.outlier] == []
    error = frames.log(frames.inverse(result.matrix) @ TRUTH["gripper_T_camera"])
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.1
    assert np.linalg.norm(error[3:]) < 1e-3
    with pycolmap.Database.open(tmp_path / "sfm" / "database.db") as db:
        places = np.vstack([db.read_keypoints(i.image_id)[:, :2] for i in db.read_all_images()])
    deep = cv2.erode(inside(), np.ones((15, 15)))
    column, row = places.astype(int).T
    # Nothing of it is seen where a third of the view is.
    assert np.mean(deep > 0) > 0.3
    assert np.mean(deep[row, column] > 0) < 0.06
