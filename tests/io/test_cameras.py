from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handeye_fg.errors import InputDataError
from handeye_fg.io.cameras import read_camera

quick = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
K = np.array([[600.5, 0.0, 321.25], [0.0, 598.25, 239.5], [0.0, 0.0, 1.0]])


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "camera.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def ros(folder: Path, model: str | None = "plumb_bob", D: Any = (), **changes: Any) -> Path:
    """A camera_info file; a change to None leaves the key out."""
    document = {
        "image_width": 640,
        "image_height": 480,
        "camera_name": "left",
        "camera_matrix": {"rows": 3, "cols": 3, "data": K.ravel().tolist()},
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": len(D), "data": list(D)},
    } | changes
    return written(folder, yaml.safe_dump({k: v for k, v in document.items() if v is not None}))


def opencv(folder: Path, D: Any, K_key: str, D_key: str) -> Path:
    path = folder / "opencv.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Fri 13 Mar: noon")
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write(K_key, K)
    storage.write(D_key, np.asarray(D, dtype=np.float64))
    storage.release()
    return path


@pytest.mark.parametrize(
    ("name", "D", "model"),
    [
        ("plumb_bob", [0.0] * 5, "OPENCV"),
        ("plumb_bob", [], "PINHOLE"),
        ("none", [], "PINHOLE"),
        ("", [0.0] * 14, "OPENCV"),
        ("plumb_bob", [-0.21, 0.08, 1e-3, -2e-3], "OPENCV"),
        ("plumb_bob", [-0.21, 0.08, 1e-3, -2e-3, 0.0], "OPENCV"),
        ("plumb_bob", [-0.21, 0.08, 1e-3, -2e-3, 0.03], "FULL_OPENCV"),
        ("rational_polynomial", [0.4, -0.2, 1e-3, -2e-3, 0.03, 0.5, -0.1, 0.02], "FULL_OPENCV"),
        ("rational_polynomial", [0.4, -0.2, 1e-3, -2e-3, 0.0, 0.0, 0.0, 0.02], "FULL_OPENCV"),
        ("rational_polynomial", [0.4, -0.2, 1e-3, -2e-3] + [0.0] * 8, "OPENCV"),
        ("equidistant", [-0.02, 0.01, -3e-3, 1e-3], "OPENCV_FISHEYE"),
        ("fisheye", [0.0] * 4, "OPENCV_FISHEYE"),
    ],
)
def test_projects_as_opencv_but_for_half_a_pixel(
    tmp_path: Path, name: str, D: list[float], model: str
) -> None:
    camera = read_camera(ros(tmp_path, name, D))
    assert (camera.model, camera.width, camera.height) == (model, 640, 480)
    points = np.random.default_rng(0).uniform([-0.4, -0.3, 1.0], [0.4, 0.3, 1.0], (20, 3))
    zero = np.zeros(3)
    if model == "OPENCV_FISHEYE":
        pixels, _ = cv2.fisheye.projectPoints(points[None], zero, zero, K, np.array(D))
    else:
        pixels, _ = cv2.projectPoints(points, zero, zero, K, np.array(D))
    colmap = pycolmap.Camera(model=model, width=640, height=480, params=camera.params)
    # Two evaluations of the same formula in double precision at some hundred pixels.
    np.testing.assert_allclose(
        colmap.img_from_cam(points) - pixels.reshape(-1, 2), 0.5, rtol=0.0, atol=1e-9
    )


@pytest.mark.parametrize(
    ("K_key", "D_key"),
    [
        ("camera_matrix", "distortion_coefficients"),
        ("cameraMatrix", "distCoeffs"),
        ("K", "D"),
        ("camera_matrix", "dist_coeffs"),
    ],
)
@pytest.mark.parametrize("as_column", [False, True])
def test_files_that_opencv_writes(tmp_path: Path, K_key: str, D_key: str, as_column: bool) -> None:
    D = np.array([[-0.21, 0.08, 1e-3, -2e-3, 0.03]])
    camera = read_camera(opencv(tmp_path, D.T if as_column else D, K_key, D_key))
    assert camera.model == "FULL_OPENCV"
    np.testing.assert_array_equal(
        camera.params,
        [600.5, 598.25, 321.75, 240.0, -0.21, 0.08, 1e-3, -2e-3, 0.03, 0.0, 0.0, 0.0],
    )


OPENCV_OLD = """%YAML:1.0
---
calibration_date: 2024-02-30
image_width: 640
image_height: 480
fisheye_model: {flag}
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 600., 0., 320., 0., 600., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ 1e-3, -2.e-02, .3e-1,
       4.0000000000000001e-03 ]
"""


@pytest.mark.parametrize(("flag", "model"), [(0, "OPENCV"), (1, "OPENCV_FISHEYE")])
def test_opencv_s_old_header_and_fisheye_flag(tmp_path: Path, flag: int, model: str) -> None:
    camera = read_camera(written(tmp_path, OPENCV_OLD.format(flag=flag)))
    assert camera.model == model
    np.testing.assert_array_equal(
        camera.params, [600.0, 600.0, 320.5, 240.5, 1e-3, -2e-2, 0.03, 4e-3]
    )


@pytest.mark.parametrize(
    ("text", "model"),
    [
        (
            (
                "width: 640\nheight: 480\ndistortion_model: plumb_bob\nD: [0, 0, 0, 0, 0]\n"
                "K: [600, 0, 320, 0, 600, 240, 0, 0, 1]\nbinning_x: 0\nbinning_y: 1\n"
                "roi: {x_offset: 0, y_offset: 0, height: 480, width: 640, do_rectify: false}\n---\n"
            ),
            "OPENCV",
        ),
        (
            (
                "image_width: 640\nimage_height: 480\nK: [[600, 0, 320], [0, 600, 240], [0, 0, 1]]\n"
                "D: {data: []}"
            ),
            "PINHOLE",
        ),
        (
            (
                "width: 640\nheight: 480\nk: [6e2, 0, 320, 0, 6.e2, 240, 0, 0, 1]\n"
                "distortion_model: none\nroi: {do_rectify: false}"
            ),
            "PINHOLE",
        ),
    ],
)
def test_echoed_messages_and_plain_lists(tmp_path: Path, text: str, model: str) -> None:
    camera = read_camera(written(tmp_path, text))
    assert camera.model == model
    np.testing.assert_array_equal(camera.params[:4], [600.0, 600.0, 320.5, 240.5])
    assert not camera.params[4:].any()


def with_K(i: int, j: int, value: float) -> dict[str, Any]:
    matrix = K.copy()
    matrix[i, j] = value
    return {"camera_matrix": {"rows": 3, "cols": 3, "data": matrix.ravel().tolist()}}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image_width": None}, r"no key image_width.* add the key image_width \(also read: width"),
        ({"image_height": None}, "no key image_height, but the images' height in pixels is needed"),
        ({"width": 640}, "image_width and width say the same thing"),
        ({"image_width": 0}, "image_width is 0, but must be an integer from 1"),
        ({"image_width": 640.5}, "image_width is 640.5, but must be an integer"),
        ({"image_height": True}, "image_height is True, but must be an integer"),
        ({"image_height": "tall"}, "image_height is 'tall', but must be an integer"),
        ({"camera_matrix": None}, "no key camera_matrix, but the 3x3 matrix"),
        ({"camera_matrix": "K"}, "camera_matrix is 'K', but must be n finite numbers"),
        ({"camera_matrix": [1.0, 2.0]}, "camera_matrix is .* but must be 3 x 3 numbers, not 2"),
        ({"camera_matrix": {"rows": 3}}, "camera_matrix.data is missing, but must be n finite"),
        ({"camera_matrix": {"data": [1], "rows": 3}}, "camera_matrix.cols is missing"),
        ({"camera_matrix": {"data": [1], "rows": 3, "cols": 3}}, "must be 3 x 3 numbers, as rows"),
        ({"camera_matrix": {1: [1]}}, "camera_matrix is .*must be a mapping with names"),
        (with_K(0, 1, 0.5), r"camera_matrix is .* without skew \(found 0.5 in row 1"),
        (with_K(1, 0, 0.5), "must be fx 0 cx; 0 fy cy; 0 0 1"),
        (with_K(2, 2, 2.0), "must be fx 0 cx; 0 fy cy; 0 0 1"),
        (with_K(0, 0, -600.5), "positive focal lengths, not -600.5 and 598.25"),
        (with_K(1, 1, 0.0), "positive focal lengths, not 600.5 and 0"),
        (with_K(0, 2, np.nan), "camera_matrix.data is .*must be n finite numbers"),
        (with_K(1, 2, np.inf), "camera_matrix.data is .*must be n finite numbers"),
        ({"distortion_coefficients": None}, r"no key distortion_coefficients.*\[\] for none"),
        ({"distortion_coefficients": [0.1]}, "4 or 5 coefficients for .*'plumb_bob', not 1"),
        (
            {"distortion_model": "mystery"},
            "distortion_model is 'mystery', but must be one of 'none'",
        ),
        ({"distortion_model": 5}, "distortion_model is 5, but must be one of"),
        ({"d": [0.0] * 5}, "distortion_coefficients and d say the same thing"),
        ({"binning_x": 2}, "binning_x is 2, but must be 0 or 1, as binned images"),
        ({"roi": {"x_offset": 5}}, "roi.x_offset is 5, but must be 0, as cropped"),
        ({"roi": {"width": 320}}, "roi.width is 320, but must be 0 or 640, as cropped"),
    ],
)
def test_errors_name_key_value_and_wanted(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputDataError, match=f"^camera file .*camera.yaml: .*{message}") as caught:
        read_camera(ros(tmp_path, **changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("model", "D", "message"),
    [
        ("rational_polynomial", [0.1] * 5, "8 or 12 or 14 coefficients .*'rational.*, not 5"),
        ("rational_polynomial", [0.1] * 9 + [0.0] * 3, "zero from the ninth .* thin-prism"),
        (None, [0.1] * 4 + [0.0] * 9 + [0.1], "zero from the ninth .* thin-prism or tilt"),
        (None, [0.1] * 3, "0 or 4 or 5 or 8 or 12 or 14 coefficients .*'of OpenCV', not 3"),
        ("equidistant", [0.1] * 5, "4 coefficients for distortion model 'equidistant', not 5"),
        ("none", [0.1], "0 coefficients for distortion model 'none', not 1"),
    ],
)
def test_distortion_that_cannot_be_kept_is_refused(
    tmp_path: Path, model: str | None, D: list[float], message: str
) -> None:
    with pytest.raises(InputDataError, match=f"distortion_coefficients is .*{message}"):
        read_camera(ros(tmp_path, model, D))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        (b"\xff\xfe\x00", "byte 0 is not UTF-8"),
        ("a: [1, 2", "not valid YAML"),
        ("a: &x [1]\nb: *x", r"not valid YAML \(aliases are not supported"),
        ("K: [1]\nK: [2]", r"not valid YAML \(a key occurs twice in the mapping in line 1"),
        ("a: !!python/object/apply:os.getcwd []", "not valid YAML .*could not determine a constr"),
        ("a: !!opencv-matrix [1]", "opencv-matrix must be a mapping"),
        ("a: !!int x", "not valid YAML"),
        ("a: !!bool x", "not valid YAML"),
        ("a: " + "[" * 1500, "not valid YAML"),
        ("a: " + "9" * 5000, "not valid YAML"),
        ("- 1\n- 2", r"found \[1, 2\], but wanted one mapping"),
        ("a: 1\n---\nb: 1", "found 2 documents, but wanted one mapping"),
        ("%YAML:1.0", "found 0 documents, but wanted one mapping"),
        ("# " + "x" * 100_000, "100002 characters are too many for a camera file"),
        ("width: 0x" + "f" * 5000, r"not valid YAML \(a value of 5002 characters\)"),
        ("width: 4\nheight: 3\nK: [1, 0, 0x" + "f" * 500 + "]", "must be n finite numbers"),
    ],
)
def test_what_is_no_camera_file_is_refused(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(InputDataError, match=f"^camera file .*camera.yaml: .*{message}") as caught:
        read_camera(written(tmp_path, text))
    assert len(str(caught.value)) < 700 + len(str(tmp_path))


@quick
@given(st.one_of(st.binary(max_size=200), st.text(max_size=200).map(str.encode)))
def test_nothing_but_input_data_errors(tmp_path: Path, content: bytes) -> None:
    for text in (content, b"image_width: 640\nimage_height: 480\nK: " + content):
        with pytest.raises(InputDataError):
            read_camera(written(tmp_path, text))


values = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(),
        st.floats(),
        st.text(max_size=5),
        st.just(K.ravel().tolist()),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=5),
        st.dictionaries(st.sampled_from(["rows", "cols", "data", "width"]), inner),
    ),
    max_leaves=6,
)


@quick
@given(
    st.dictionaries(
        st.sampled_from(
            ["image_width", "image_height", "K", "D", "distortion_model", "roi", "binning_x"]
        ),
        values,
    )
)
def test_odd_values_give_a_camera_or_an_input_data_error(
    tmp_path: Path, changes: dict[str, Any]
) -> None:
    whole = {"image_width": 640, "image_height": 480, "K": K.tolist(), "D": [0.0] * 5}
    try:
        camera = read_camera(written(tmp_path, yaml.safe_dump(whole | changes)))
    except InputDataError:
        return
    assert np.isfinite(camera.params).all()
