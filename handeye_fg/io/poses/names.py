"""Names of files that a user's file may give."""

from pathlib import PurePosixPath, PureWindowsPath

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import shown


def check_name(name: object, where: str) -> None:
    """Refuse what is no name of a file in the image folder.

    Raises:
        InputDataError: the name is empty or leads out of the folder.
    """
    if not isinstance(name, str) or not name.strip():
        raise InputDataError(f"{where}: {shown(name)} is no image name; name the image's file")
    for kind in (PurePosixPath, PureWindowsPath):
        if kind(name).anchor or ".." in kind(name).parts:
            raise InputDataError(
                f"{where}: {shown(name)} leads out of the image folder; give the name of a file in"
                " the folder"
            )
