"""Camera files of Kalibr, COLMAP, nerfstudio and JSON, each against the projection of that program."""

import json
import math
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from PIL import Image

from handeye_fg.errors import InputDataError
from handeye_fg.inputs import read_inputs
from handeye_fg.io.cameras import read_camera, read_cameras
from handeye_fg.lens import MODELS, embedding
from handeye_fg.options import Options
from handeye_fg.progress import silent
from handeye_fg.simulate import project
from handeye_fg.types import CameraModel

K = np.array([[600.5, 0.0, 321.25], [0.0, 598.25, 239.5], [0.0, 0.0, 1.0]])
POINTS = np.random.default_rng(0).uniform([-0.4, -0.3, 1.0], [0.4, 0.3, 1.0], (20, 3))


def written(folder: Path, name: str, content: Any) -> Path:
    path = folder / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        text = content if isinstance(content, str) else json.dumps(content)
        path.write_text(text)
    return path


def camchain(**changes: Any) -> dict[str, Any]:
    return {
        "cam_overlaps": [1],
        "camera_model": "pinhole",
        "distortion_coeffs": [-0.28, 0.07, 2e-4, -1e-4],
        "distortion_model": "radtan",
        "intrinsics": [600.5, 598.25, 321.25, 239.5],
        "resolution": [640, 480],
        "rostopic": "/cam0/image_raw",
    } | changes


@pytest.mark.parametrize(
    ("distortion", "D", "model"),
    [
        ("radtan", [-0.28, 0.07, 2e-4, -1e-4], "OPENCV"),
        ("equidistant", [-0.02, 0.01, -3e-3, 1e-3], "OPENCV_FISHEYE"),
        ("none", [], "PINHOLE"),
        ("none", [0.0] * 4, "PINHOLE"),
    ],
)
def test_kalibr_projects_as_opencv(
    tmp_path: Path, distortion: str, D: list[float], model: str
) -> None:
    chain = {"cam0": camchain(distortion_model=distortion, distortion_coeffs=D)}
    camera = read_camera(written(tmp_path, "camchain.yaml", yaml.safe_dump(chain)))
    assert (camera.model, camera.width, camera.height) == (model, 640, 480)
    zero = np.zeros(3)
    if model == "OPENCV_FISHEYE":
        pixels, _ = cv2.fisheye.projectPoints(POINTS[None], zero, zero, K, np.array(D))
    else:
        pixels, _ = cv2.projectPoints(POINTS, zero, zero, K, np.array(D))
    np.testing.assert_allclose(project(camera, POINTS), pixels.reshape(-1, 2) + 0.5, atol=1e-9)


def test_a_sensor_of_euroc(tmp_path: Path) -> None:
    text = """%YAML:1.0
# General sensor definitions.
sensor_type: camera
T_BS: {cols: 4, rows: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
"""
    camera = read_camera(written(tmp_path, "sensor.yaml", text))
    assert camera.model == "OPENCV"
    np.testing.assert_allclose(camera.params[:4], [458.654, 457.296, 367.715, 248.875])
    assert camera.params[7] == 1.76187114e-05


def test_several_cameras_go_to_their_folders(tmp_path: Path) -> None:
    chain = {f"cam{k}": camchain(intrinsics=[600.0 + k, 600.0, 320.0, 240.0]) for k in (0, 1)}
    path = written(tmp_path, "camchain.yaml", yaml.safe_dump(chain))
    assert list(read_cameras(path)) == ["cam0", "cam1"]
    with pytest.raises(InputDataError, match=r"has 2 cameras \(cam0, cam1\), but one was wanted"):
        read_camera(path)
    poses = {f"{i}.png": np.eye(4) for i in range(3)}
    for folder in ("cam0", "cam1"):
        (tmp_path / "images" / folder).mkdir(parents=True)
        for i in range(3):
            noise = np.random.default_rng(i).integers(0, 255, (480, 640), dtype=np.uint8)
            Image.fromarray(noise).save(tmp_path / "images" / folder / f"{i}.png")

    def cameras(source: Path) -> dict[str, float]:
        found = read_inputs(tmp_path / "images", poses, source, None, Options(), silent)
        assert found.cameras is not None
        return {folder: camera.params[0] for folder, camera in found.cameras.items()}

    assert cameras(path) == {"cam0": 600.0, "cam1": 601.0}
    one = written(tmp_path, "one.yaml", yaml.safe_dump({"cam0": camchain()}))
    assert cameras(one) == {"cam0": 600.5, "cam1": 600.5}
    files = tmp_path / "files"
    files.mkdir()
    written(files, "cam0.yaml", yaml.safe_dump({"cam0": camchain()}))
    written(files, "cam1.json", {"width": 640, "height": 480, "fx": 9, "fy": 9, "cx": 1, "cy": 2})
    assert cameras(files) == {"cam0": 600.5, "cam1": 9.0}
    written(files, "cam1.yaml", yaml.safe_dump({"cam0": camchain()}))
    with pytest.raises(InputDataError, match="are of one camera; keep one of them"):
        cameras(files)
    chain["cam2"] = chain.pop("cam1")
    path = written(tmp_path, "camchain.yaml", yaml.safe_dump(chain))
    with pytest.raises(
        InputDataError, match=r"has the cameras cam0, cam2, but .* so that cam1 has"
    ):
        cameras(path)


def colmap_cameras() -> pycolmap.Reconstruction:
    """A camera of each model that is understood."""
    model = pycolmap.Reconstruction()
    for k, name in enumerate(MODELS, start=1):
        n = embedding(name).shape[1]
        params = [500.0, 501.0, 320.0, 240.0, *[0.01 * i for i in range(1, 9)]]
        if embedding(name)[2, 2] == 0.0:  # one focal length
            params = params[:1] + params[2:]
        model.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=k, model=name, width=640, height=480, params=params[:n])
        )
    return model


@pytest.mark.parametrize("suffix", ["bin", "txt"])
def test_colmap(tmp_path: Path, suffix: str) -> None:
    model = colmap_cameras()
    (model.write_binary if suffix == "bin" else model.write_text)(tmp_path)
    cameras = read_cameras(tmp_path / f"cameras.{suffix}")
    assert [camera.model for camera in cameras.values()] == list(MODELS)
    for key, camera in cameras.items():
        native = model.cameras[int(key)]
        assert camera.params.tolist() == list(native.params)
        np.testing.assert_allclose(project(camera, POINTS), native.img_from_cam(POINTS), atol=1e-9)
    with pytest.raises(InputDataError, match=f"has {len(MODELS)} cameras"):
        read_camera(tmp_path)


def test_a_folder_with_one_camera_for_each_image(tmp_path: Path) -> None:
    """COLMAP's default: as many cameras as images; with the same numbers they are one."""
    model = pycolmap.Reconstruction()
    for k in (1, 2, 3):
        model.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=k, model="PINHOLE", width=64, height=48, params=[9, 9, 3, 2])
        )
    model.write(tmp_path)
    assert read_camera(tmp_path).params.tolist() == [9.0, 9.0, 3.0, 2.0]


@pytest.mark.parametrize("name", ["FOV", "THIN_PRISM_FISHEYE", "EUCM", "SIMPLE_DIVISION"])
def test_models_of_colmap_that_are_not_understood(tmp_path: Path, name: str) -> None:
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, name, 500.0, 640, 480)
    model.add_camera_with_trivial_rig(camera)
    model.write_binary(tmp_path)
    model.write_text(tmp_path)
    for suffix in ("bin", "txt"):
        with pytest.raises(InputDataError, match="is not one that is understood exactly"):
            read_camera(tmp_path / f"cameras.{suffix}")


TRANSFORMS: dict[str, Any] = {
    "camera_model": "OPENCV",
    "fl_x": 600.5,
    "fl_y": 598.25,
    "cx": 321.75,
    "cy": 240.0,
    "w": 640,
    "h": 480,
    "k1": -0.28,
    "k2": 0.07,
    "p1": 2e-4,
    "p2": -1e-4,
    "frames": [{"file_path": "images/0.png", "transform_matrix": np.eye(4).tolist()}],
}


def test_nerfstudio_projects_as_colmap(tmp_path: Path) -> None:
    def of(**changes: Any) -> CameraModel:
        return read_camera(written(tmp_path, "transforms.json", TRANSFORMS | changes))

    zero = np.zeros(3)
    for k3, model in ((0.0, "OPENCV"), (0.02, "FULL_OPENCV")):
        camera = of(k3=k3)
        assert camera.model == model
        D = np.array([-0.28, 0.07, 2e-4, -1e-4, k3])
        pixels, _ = cv2.projectPoints(POINTS, zero, zero, K, D)
        np.testing.assert_allclose(project(camera, POINTS), pixels[:, 0] + 0.5, atol=1e-9)
    fisheye = of(camera_model="OPENCV_FISHEYE", p1=0.0, p2=0.0, k3=0.01, k4=-0.02)
    pixels, _ = cv2.fisheye.projectPoints(
        POINTS[None], zero, zero, K, np.array([-0.28, 0.07, 0.01, -0.02])
    )
    np.testing.assert_allclose(project(fisheye, POINTS), pixels[0] + 0.5, atol=1e-9)
    blender = written(
        tmp_path, "t.json", {"camera_angle_x": math.pi / 2, "w": 640, "h": 480, "frames": []}
    )
    assert read_camera(blender).params.tolist() == pytest.approx([320.0, 320.0, 320.0, 240.0])
    own = {key: TRANSFORMS[key] for key in TRANSFORMS if key not in {"camera_model", "frames"}}
    frames = [{**own, "file_path": f"{i}.png"} for i in range(3)]
    by_frame = {"camera_model": "OPENCV", "frames": frames}
    assert (
        read_camera(written(tmp_path, "f.json", by_frame)).params.tolist() == of().params.tolist()
    )
    frames[2] = {**frames[2], "fl_x": 600.0}
    with pytest.raises(InputDataError, match=r"frames\[2\] has other intrinsics than frames\[0\]"):
        read_camera(written(tmp_path, "f.json", by_frame))


def test_plain_json(tmp_path: Path) -> None:
    numbers = {"width": 640, "height": 480, "fx": 600.5, "fy": 598.25}
    expected = [600.5, 598.25, 321.75, 240.0]
    for centre in ({"cx": 321.25, "cy": 239.5}, {"ppx": 321.25, "ppy": 239.5}):
        camera = read_camera(written(tmp_path, "c.json", numbers | centre))
        assert (camera.model, camera.params.tolist()) == ("PINHOLE", expected)
        both = numbers | centre | {"coeffs": [0.1, 0.2, 0.3, 0.4, 0.0]}
        camera = read_camera(written(tmp_path, "c.json", both))
        assert camera.model == "OPENCV"
        assert camera.params.tolist() == [*expected, 0.1, 0.2, 0.3, 0.4]
    as_opencv = {"image_width": 640, "image_height": 480, "K": K.tolist(), "D": []}
    assert read_camera(written(tmp_path, "c.json", as_opencv)).params.tolist() == expected
    ours = {
        "model": "SIMPLE_RADIAL",
        "width": 640,
        "height": 480,
        "params": [500, 320.5, 240.5, 0.1],
    }
    path = written(tmp_path, "c.json", ours)
    assert read_camera(path).params.tolist() == [500.0, 320.5, 240.5, 0.1]
    path = written(tmp_path, "c.json", ours | {"first_pixel_centre": 0})
    assert read_camera(path).params.tolist() == [500.0, 321.0, 241.0, 0.1]
    path = written(tmp_path, "result.json", {"schema_version": "1", "intrinsics": ours})
    assert read_camera(path).params.tolist() == [500.0, 320.5, 240.5, 0.1]


BIN = struct.pack("<QIiQQ4d", 1, 1, 1, 640, 480, 500.0, 500.0, 320.0, 240.0)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("k.yaml", {"cam0": camchain(camera_model="omni")}, "cam0.camera_model is 'omni', but must be 'pinhole'"),
        ("k.yaml", {"cam0": camchain(distortion_model="fov")}, "cam0.distortion_model is 'fov'.* field-of-view"),
        ("k.yaml", {"cam0": camchain(distortion_coeffs=[0.1] * 5)}, "must be 4 coefficients"),
        ("k.yaml", {"cam0": camchain(distortion_coefficients=[0.1] * 4)}, "is there twice"),
        ("k.yaml", {"cam0": {**camchain(), "distortion_coeffs": None}}, "must be n finite numbers"),
        ("k.yaml", {"cam0": camchain(resolution=[640.5, 480])}, "width and height in whole pixels"),
        ("k.yaml", {"cam0": camchain(intrinsics=[0, 1, 2, 3])}, "positive focal lengths"),
        ("k.yaml", {"cam0": 5}, "cam0 is 5, but must be a mapping"),
        ("cameras.txt", "1 PINHOLE 640 480 500 500 320", "PINHOLE has 4 finite parameters"),
        ("cameras.txt", "1 PINHOLE 640 480 500 500 320 nan", "PINHOLE has 4 finite parameters"),
        ("cameras.txt", "1 PINHOLE 640 480 500 500 320 x", "line 1: could not convert"),
        ("cameras.txt", "1 PINHOLE 640 0 500 500 320 240", "size is 640 x 0, but must be 1 to"),
        ("cameras.txt", "1 PINHOLE 6 4 -5 500 320 240", "focal length is -5, but must be positive"),
        ("cameras.txt", "# x\n1 PINHOLE 6 4 5 5 3 2\nhello", "line 3: found 'hello', but wanted CAMERA_ID"),
        ("cameras.txt", "1 PINHOLE 6 4 5 5 3 2\n1 PINHOLE 6 4 5 5 3 2", "line 2: camera 1 is already there"),
        ("cameras.bin", BIN[:-3], "ends after 61 bytes, within a camera"),
        ("cameras.bin", BIN + b"x", "1 bytes follow the last camera"),
        ("cameras.bin", b"", "ends after 0 bytes"),
        ("cameras.bin", b"\xff" * 80, "says that it holds 18446744073709551615 cameras"),
        ("cameras.bin", BIN[:12] + b"\x63" + BIN[13:], "camera model number 99 is not one"),
        ("t.json", TRANSFORMS | {"k4": 0.1}, "k4 is 0.1, but must be 0, as no camera model"),
        ("t.json", TRANSFORMS | {"camera_model": "EQUIRECTANGULAR"}, "must be one of 'OPENCV'"),
        ("t.json", TRANSFORMS | {"camera_model": "OPENCV_FISHEYE"}, "p1 is 0.0002, but must be 0 for a fish"),
        ("t.json", TRANSFORMS | {"fl_x": -1}, "fl_x is -1, but must be a positive focal length"),
        ("t.json", {"camera_angle_x": 4, "w": 6, "h": 4}, "camera_angle_x is 4, but must be an angle"),
        ("t.json", {"camera_angle_x": 1, "frames": []}, "there is no key image_width"),
        ("t.json", "[1, 2]", r"found \[1, 2\], but wanted an object"),
        ("t.json", "{", "not valid JSON"),
        ("t.json", "[" * 100_000, "not valid JSON"),
        ("t.json", '{"fl_x": 1e999, "w": 6, "h": 4}', "fl_x is inf, but must be a finite number"),
        ("t.json", {"width": 6, "height": 4, "fx": 0, "fy": 1, "cx": 0, "cy": 0}, "fx is 0, but must be a pos"),
        ("t.json", {"model": "FOV", "params": [1]}, "model is 'FOV', but must be one of"),
        ("t.json", {"model": "PINHOLE", "params": [1], "w": 6, "h": 4}, "must be 4 finite numbers"),
        (
            "t.json",
            {"model": "PINHOLE", "params": [1, 1, 1, 1], "w": 6, "h": 4, "first_pixel_centre": 1},
            "first_pixel_centre is 1, but must be 0.5 as in COLMAP, or 0",
        ),
    ],
)  # fmt: skip
def test_errors_name_what_was_found_and_wanted(
    tmp_path: Path, name: str, content: Any, message: str
) -> None:
    path = written(tmp_path, name, content)
    with pytest.raises(InputDataError, match=f"^camera file .*{name}.*{message}") as caught:
        read_camera(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 900 + len(str(tmp_path))


def test_a_folder_that_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="is a folder, but not that of a COLMAP model"):
        read_camera(tmp_path)
    with pytest.raises(InputDataError, match="no such file"):
        read_camera(tmp_path / "cameras.bin")


BOMB = "a: &a [x,x,x]\nb: &b [*a,*a,*a]\nc: &c [*b,*b,*b]\ncam0: *c\n"
numbers = st.one_of(st.integers(), st.floats(), st.text(max_size=4), st.none(), st.booleans())
values = st.recursive(
    numbers,
    lambda inner: st.one_of(
        st.lists(inner, max_size=5), st.dictionaries(st.text(max_size=3), inner)
    ),
    max_leaves=5,
)
WHOLE: list[dict[str, Any]] = [
    {"cam0": camchain(), "cam1": camchain()},
    camchain(),
    TRANSFORMS,
    {"model": "PINHOLE", "width": 640, "height": 480, "params": [5, 5, 3, 2]},
    {"width": 6, "height": 4, "fx": 1, "fy": 1, "cx": 0, "cy": 0, "D": [0.0] * 4},
]


@st.composite
def damaged(draw: st.DrawFn) -> tuple[str, bytes]:
    """A file of some kind with something else in a place, cut off, or with other bytes in it."""
    whole = draw(st.sampled_from(WHOLE))
    inner = whole.get("cam0", whole)
    changed = {**inner, draw(st.sampled_from(sorted(inner))): draw(values)}
    text = json.dumps({**whole, "cam0": changed} if "cam0" in whole else changed)
    txt = "# Camera list\n1 OPENCV 640 480 500 500 320 240 0.1 0.1 0 0\n"
    contents = {"a.json": text, "a.yaml": text, "cameras.txt": txt}
    name = draw(st.sampled_from([*contents, "cameras.bin"]))
    data = contents[name].encode() if name in contents else BIN
    if draw(st.booleans()):
        i = draw(st.integers(0, len(data)))
        j = draw(st.integers(i, min(len(data), i + 12)))
        data = data[:i] + draw(st.binary(max_size=12)) + data[j:]
    return name, data


@settings(
    max_examples=700, deadline=20_000, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.one_of(
        damaged(),
        st.tuples(st.sampled_from(["a.yaml", "a.json", "cameras.bin", "cameras.txt"]), st.binary()),
    )
)
@example(("a.yaml", BOMB.encode()))
@example(("a.json", b'{"cam0": "\0"}'))
def test_any_content_gives_a_camera_or_a_clean_error(
    tmp_path: Path, file: tuple[str, bytes]
) -> None:
    path = written(tmp_path, *file)
    camera, error = None, ""
    try:
        camera = read_camera(path)
    except InputDataError as caught:
        error = str(caught)
    if camera is None:
        assert str(path) in error
        assert "\n" not in error
        return
    assert np.isfinite(camera.params).all()
    assert camera.model in MODELS
    assert camera.width > 0
    assert camera.height > 0
