from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handeye_fg import DataSet, InputDataError
from handeye_fg.batching.manifest import checked, read_data_sets

HEADER = "name,images,poses"


def read(tmp_path: Path, text: str, name: str = "fleet.csv") -> tuple[DataSet, ...]:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return read_data_sets(path)


def test_csv(tmp_path: Path) -> None:
    text = (
        "name, images, poses, camera, config, reference\n"
        "robot 7,r7/images,r7/poses.csv,,run.toml,\n"
        "\n"
        '"Zelle, Süd",s3://fleet/8/images,/abs/poses.csv,cam.yaml,,old/result.json\n'
    )
    first, second = read(tmp_path, text)
    assert first == DataSet(
        name="robot 7",
        images=str(tmp_path / "r7/images"),
        poses=str(tmp_path / "r7/poses.csv"),
        config=str(tmp_path / "run.toml"),
    )
    assert second == DataSet(
        name="Zelle, Süd",
        images="s3://fleet/8/images",
        poses="/abs/poses.csv",
        camera=str(tmp_path / "cam.yaml"),
        reference=str(tmp_path / "old/result.json"),
    )


def test_yaml_says_the_same_as_csv(tmp_path: Path) -> None:
    text = "data_sets:\n- {name: a, model: m, poses: p.csv}\n- {name: b, images: i, poses: q.csv, camera: null}\n"
    table = "name,model,images,poses\na,m,,p.csv\nb,,i,q.csv\n"
    assert read(tmp_path, text, "fleet.yaml") == read(tmp_path, table)


@pytest.mark.parametrize(
    ("text", "where", "what"),
    [
        (f"{HEADER}\n", "one line", "header"),
        (f"{HEADER}\n,,\n", "no data set", "a row for each"),
        ("name,images,poses,cam\na,i,p,c\n", "line 1", "column 'cam' is unknown"),
        ("name,images,poses,name\na,i,p,b\n", "line 1", "column name occurs twice"),
        ("name,images\na,i\n", "line 1", "column poses is missing"),
        (f"{HEADER}\na,i,p\nb,i\n", "line 3", "column poses is empty"),
        (f"{HEADER}\na,i,p\nb,i,p,x\n", "line 3", "4 cells"),
        (f"{HEADER}\n,i,p\n", "line 2", "column name is ''"),
        (f"{HEADER}\na,i,p\nA,i,p\n", "line 3", "column name: 'A' is already the name in manifest"),
        (f"{HEADER}\na,,p\n", "line 2", "column images and model are both empty"),
        ("name,images,model,poses\na,i,m,p\n", "line 2", "column images and model are both given"),
        ("name,model,poses,masks\na,m,p,k\n", "line 2", "column masks is given"),
        (f'{HEADER}\n"a,i,p\n', "line 2", "not a CSV table"),
    ],
)
def test_errors_of_a_csv_name_line_and_column(
    tmp_path: Path, text: str, where: str, what: str
) -> None:
    with pytest.raises(InputDataError) as caught:
        read(tmp_path, text)
    assert where in str(caught.value)
    assert what in str(caught.value)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("data_sets: 3\n", "data_sets is 3"),
        ("sets: []\n", "'sets' is not a key"),
        ("data_sets: []\n", "no data set"),
        ("data_sets:\n- {name: a, images: i, poses: [p]}\n", "data_sets[0].poses is ['p']"),
        (
            "data_sets:\n- {name: ../a, images: i, poses: p}\n",
            "data_sets[0], column name is '../a'",
        ),
        ("data_sets:\n- {name: a, poses: p}\n", "data_sets[0], column images and model are both"),
        ("data_sets:\n- !!python/object:os.system {}\n", "not valid YAML"),
    ],
)
def test_errors_of_a_yaml_name_item_and_key(tmp_path: Path, text: str, what: str) -> None:
    with pytest.raises(InputDataError) as caught:
        read(tmp_path, text, "fleet.yml")
    assert what in str(caught.value)


@given(st.text(max_size=130))
def test_a_name_is_one_folder_or_none(name: str) -> None:
    try:
        data = DataSet(name=name, images="i", poses="p")
    except ValueError:
        return
    assert (Path("/out") / data.name).parent == Path("/out")
    assert data.name not in ("", ".", "..")
    assert "\\" not in data.name
    assert data.name[0] not in "=+-@."  # a spreadsheet takes such a cell for a formula


@pytest.mark.parametrize("name", ["..", ".", "a/b", "/a", "a\\b", "a\n", "summary.csv", "a.", "=a"])
def test_names_that_lead_out_or_astray_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="name is"):
        DataSet(name=name, images="i", poses="p")


def test_folder_of_folders(tmp_path: Path) -> None:
    for place in ("b/images", "b/masks", "a/sparse/0", "c", ".hidden/images", "out/images"):
        (tmp_path / place).mkdir(parents=True)
    for place in ("b/poses.csv", "b/camera.yaml", "a/poses.csv", "a/config.toml", "a/camera.yaml"):
        (tmp_path / place).touch()
    (tmp_path / "note.txt").touch()
    found = read_data_sets(tmp_path, left_out=tmp_path / "out")
    a, b, c = (tmp_path / name for name in "abc")
    assert found == (
        DataSet(
            name="a",
            model=str(a / "sparse/0"),
            poses=str(a / "poses.csv"),
            config=str(a / "config.toml"),
        ),
        DataSet(
            name="b",
            images=str(b / "images"),
            poses=str(b / "poses.csv"),
            camera=str(b / "camera.yaml"),
            masks=str(b / "masks"),
        ),
        DataSet(name="c", images=str(c / "images"), poses=str(c / "poses.csv")),
    )


def test_data_sets_of_python() -> None:
    data = DataSet(name="a", images="i", poses="memory://p.csv")
    (placed,) = checked([data])
    assert placed.images == str(Path.cwd() / "i")
    assert placed.poses == "memory://p.csv"
    with pytest.raises(InputDataError, match="already the name"):
        checked([data, data])
    with pytest.raises(InputDataError, match="no data set"):
        checked([])
