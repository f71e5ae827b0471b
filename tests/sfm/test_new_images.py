"""Which features of old images say where the points of a new image are."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pycolmap

from example_cameras import SMALL
from handeye_fg.sfm.new_images import _votes
from handeye_fg.sfm.tracks import _fill
from handeye_fg.types import Tracks


def test_only_features_that_were_refined_vote(tmp_path: Path) -> None:
    """The new image matches two features of the old one, of which the model has the first."""
    pixels = np.array([[10.2, 20.4], [30.6, 10.8], [12.0, 22.0], [33.0, 9.0]])
    database = tmp_path / "features.db"
    _fill(
        database,
        ("old.jpg", "new.jpg"),
        np.array([0, 0, 1, 1]),
        np.array([0, 1, 0, 1]),
        pixels,
        {".": SMALL},
    )
    tracks = Tracks(
        points_world=np.zeros((8, 3)),
        image_index=np.array([0, 0]),
        point_index=np.array([7, 5]),
        # The second is another feature a hundredth of a pixel away.
        pixels=np.array([[10.2, 20.4], [30.61, 10.8]]),
    )
    with pycolmap.Database.open(database) as db:
        old, new = (db.read_image_with_name(name).image_id for name in ("old.jpg", "new.jpg"))
        geometry = pycolmap.TwoViewGeometry()
        geometry.inlier_matches = np.array([[0, 0], [1, 1]], dtype=np.uint32)
        db.write_two_view_geometry(new, old, geometry)
        model = SimpleNamespace(names=("old.jpg",), tracks=tracks)
        votes = _votes(db, {"old.jpg": old}, {"new.jpg": new}, model)
    assert votes == {"new.jpg": {0: {7: 1}}}
