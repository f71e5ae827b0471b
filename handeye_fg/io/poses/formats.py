"""The pose formats that robots and programs write: one line of a table each; entry ``FORMATS``."""

from dataclasses import dataclass
from typing import Literal

from handeye_fg.io.poses.convention import Convention
from handeye_fg.options import RotationKind

Container = Literal["text", "stream", "list", "folder", "index"]
Key = Literal["image", "time", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFormat:
    """How a file of poses looks, for reading and for writing.

    Attributes:
        name: of the format, for ``--pose-format``.
        title: what it is, for people.
        columns: what stands in it, in this order: the key if there is one, three numbers of the position and
            those of the rotation, or 12 or 16 of a matrix.
        convention: what the numbers mean where neither the file nor the user says otherwise.
        key: what tells the image of a row: its name, the time, or nothing.
        matrix: how a 3x4 or 4x4 matrix is listed; None: position and rotation stand apart.
        container: a text table; YAML: a stream of documents, a list, a file for each pose in a folder, or a
            file that names such files and their images.
        delimiter, header: of the text table as it is written; readers take any.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    convention: Convention
    key: Key = "image"
    matrix: Literal["rows", "columns"] | None = None
    container: Container = "text"
    delimiter: str = ","
    header: Literal["names", "comment", "none"] = "names"

    def __str__(self) -> str:
        stem, _, last = self.columns[-1].rpartition(".")
        entries = f"{stem}.0 to {stem}.{last}" if last.isdecimal() else ",".join(self.numbers)
        key = "" if self.key == "none" else f"{self.columns[0]},"
        return f"{self.title} has {key}{entries}"

    @property
    def numbers(self) -> tuple[str, ...]:
        """The columns without the key."""
        return self.columns if self.key == "none" else self.columns[1:]


def _entries(stem: str, count: int) -> tuple[str, ...]:
    return tuple(f"{stem}.{i}" for i in range(count))


_QUATERNION = ("x", "y", "z", "qx", "qy", "qz", "qw")
_METRES = Convention(rotation="xyzw")
_W_FIRST = Convention(rotation="wxyz")
_MATRIX = Convention(rotation="matrix")


def _controller(name: str, title: str, rotation: RotationKind, *angles: str) -> PoseFormat:
    """A robot's own list of position in millimetres and angles in degrees."""
    convention = Convention(rotation=rotation, unit="mm", angles="deg")
    columns = ("image", "X", "Y", "Z", *angles)
    return PoseFormat(name=name, title=title, columns=columns, convention=convention)


_ALL = (
    PoseFormat(
        name="csv",
        title="handeye-fg's own CSV",
        columns=("image", *_QUATERNION),
        convention=_METRES,
    ),
    PoseFormat(
        name="tum",
        title="TUM trajectory",
        columns=("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"),
        convention=_METRES,
        key="time",
        delimiter=" ",
        header="comment",
    ),
    PoseFormat(
        name="kitti",
        title="KITTI odometry",
        columns=_entries("kitti", 12),
        convention=_MATRIX,
        key="none",
        matrix="rows",
        delimiter=" ",
        header="none",
    ),
    PoseFormat(
        name="euroc",
        title="EuRoC ground truth",
        columns=(
            "timestamp [ns]",
            *(f"p_RS_R_{axis} [m]" for axis in "xyz"),
            *(f"q_RS_{axis} []" for axis in "wxyz"),
        ),
        convention=_W_FIRST,
        key="time",
        header="comment",
    ),
    PoseFormat(
        name="eth",
        title="CSV of ethz-asl/hand_eye_calibration",
        columns=("t", "x", "y", "z", "q_x", "q_y", "q_z", "q_w"),
        convention=_METRES,
        key="time",
        header="none",
    ),
    PoseFormat(
        name="kinhec",
        title="KinHEC's robot CSV",
        columns=(
            "t",
            *(f"base_ee_meas_p{axis}" for axis in "xyz"),
            *(f"base_ee_meas_q{axis}" for axis in "wxyz"),
        ),
        convention=_W_FIRST,
        key="time",
    ),
    PoseFormat(
        name="ros",
        title="ROS geometry_msgs as YAML or CSV, and the text of tf_echo",
        columns=(
            "header.stamp",
            *(f"pose.position.{axis}" for axis in "xyz"),
            *(f"pose.orientation.{axis}" for axis in "xyzw"),
        ),
        convention=_METRES,
        key="time",
        container="stream",
    ),
    PoseFormat(
        name="ur",
        title="Universal Robots (rotation vector)",
        columns=("image", "X", "Y", "Z", "RX", "RY", "RZ"),
        convention=Convention(rotation="rotation-vector"),
    ),
    PoseFormat(
        name="abb",
        title="ABB",
        columns=("image", "X", "Y", "Z", "Q1", "Q2", "Q3", "Q4"),
        convention=Convention(rotation="wxyz", unit="mm"),
    ),
    _controller("kuka", "KUKA", "ZYX", "A", "B", "C"),
    _controller("fanuc", "Fanuc", "xyz", "W", "P", "R"),
    _controller("yaskawa", "Yaskawa", "xyz", "Rx", "Ry", "Rz"),
    _controller("kawasaki", "Kawasaki", "ZYZ", "O", "A", "T"),
    _controller("mitsubishi", "Mitsubishi", "xyz", "A", "B", "C"),
    PoseFormat(
        name="franka",
        title="Franka O_T_EE",
        columns=("image", *_entries("O_T_EE", 16)),
        convention=_MATRIX,
        matrix="columns",
    ),
    PoseFormat(
        name="matrix",
        title="4x4 or 3x4 matrices by rows as text, JSON, YAML or .npy",
        columns=("image", *_entries("matrix", 16)),
        convention=_MATRIX,
        matrix="rows",
    ),
    PoseFormat(
        name="zivid",
        title="Zivid YAML, a file for each pose",
        columns=_entries("FloatMatrix.Data", 16),
        convention=Convention(rotation="matrix", unit="mm"),
        key="none",
        matrix="rows",
        container="folder",
    ),
    PoseFormat(
        name="visp",
        title="ViSP YAML, a file for each pose",
        columns=_entries("data", 6),
        convention=Convention(rotation="rotation-vector"),
        key="none",
        container="folder",
    ),
    PoseFormat(
        name="moveit",
        title="samples of MoveIt's hand-eye calibration",
        columns=_entries("effector_wrt_world", 16),
        convention=_MATRIX,
        key="none",
        matrix="rows",
        container="list",
    ),
    PoseFormat(
        name="robot-cal-tools",
        title="robot_cal_tools: an index of images and pose files, or the pose files",
        columns=_QUATERNION,
        convention=_METRES,
        key="none",
        container="index",
    ),
)
FORMATS = {entry.name: entry for entry in _ALL}
"""Every format by its name; where several fit a file alike, the first one counts."""
