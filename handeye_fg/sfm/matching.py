"""Matches of pairs of images in a COLMAP database; entry point ``Matcher``."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import comb
from pathlib import Path
from tempfile import TemporaryDirectory

import pycolmap

from handeye_fg.options import SfmOptions
from handeye_fg.progress import Progress
from handeye_fg.sfm.database import adopt_matches, matching_options, verification_options
from handeye_fg.sfm.features import Sensitivity
from handeye_fg.sfm.native import native_threads, run_cancellable
from handeye_fg.sfm.stages import Stage
from handeye_fg.types import Indices


@dataclass(frozen=True, slots=True, kw_only=True)
class Matcher:
    """How the images of a database are matched; pairs that are matched already stay as they are.

    Attributes:
        stage: with the features of all images.
        sensitivity: how pairs are matched.
        options: limits.
        seed: of the random samples.
        progress: told "pairs".
    """

    stage: Stage
    sensitivity: Sensitivity
    options: SfmOptions
    seed: int
    progress: Progress

    @property
    def database(self) -> Path:
        """The stage's database."""
        return self.stage.database

    def match_all(self) -> None:
        """Match all pairs.

        Raises:
            ReconstructionError: COLMAP failed.
        """
        adopt_matches(self.stage)
        with pycolmap.Database.open(self.database) as db:
            self._run(
                lambda token: pycolmap.match_exhaustive(
                    self.database,
                    matching_options=self._matching(),
                    verification_options=verification_options(self.seed),
                    device=pycolmap.Device.cpu,
                    cancellation_token=token,
                ),
                db,
                comb(db.num_images(), 2),
            )

    def match_pairs(self, pairs: Indices) -> None:
        """Match some pairs.

        Args:
            pairs: of images (k, 2), as indices in the order of their names.

        Raises:
            ReconstructionError: COLMAP failed.
        """
        adopt_matches(self.stage, pairs)
        with (
            pycolmap.Database.open(self.database) as db,
            _without_blanks(db) as names,
            TemporaryDirectory() as scratch,
        ):
            new = [
                (i, j) for i, j in pairs.tolist() if not db.exists_two_view_geometry(i + 1, j + 1)
            ]
            pairing = pycolmap.ImportedPairingOptions()
            pairing.match_list_path = Path(scratch) / "pairs.txt"
            text = "".join(f"{names[i]} {names[j]}\n" for i, j in new)
            pairing.match_list_path.write_text(text, encoding="utf-8")
            self._run(
                lambda token: pycolmap.match_image_pairs(
                    self.database,
                    matching_options=self._matching(),
                    pairing_options=pairing,
                    verification_options=verification_options(self.seed),
                    device=pycolmap.Device.cpu,
                    cancellation_token=token,
                ),
                db,
                db.num_matched_image_pairs()
                + sum(not db.exists_matches(i + 1, j + 1) for i, j in new),
            )

    def _run(
        self,
        call: Callable[[pycolmap.CancellationToken], None],
        db: pycolmap.Database,
        total: int,
    ) -> None:
        """One of COLMAP's calls, its progress counted in the database."""
        pycolmap.set_random_seed(self.seed)

        def count() -> None:
            self.progress("pairs", db.num_matched_image_pairs(), total)

        count()
        run_cancellable(call, "the matching of features", count)

    def _matching(self) -> pycolmap.FeatureMatchingOptions:
        options = matching_options(self.sensitivity)
        options.num_threads = native_threads(self.options)
        return options


@contextmanager
def _without_blanks(db: pycolmap.Database) -> Iterator[list[str]]:
    """The images' names, without blanks while COLMAP reads a list of pairs: there they end a name."""
    images = sorted(db.read_all_images(), key=lambda image: image.image_id)
    names = [image.name for image in images]
    renamed = [image for image in images if " " in image.name]
    for image in renamed:
        image.name = f"/{image.image_id}"  # no file can have this name
        db.update_image(image)
    try:
        yield [image.name for image in images]
    finally:
        for image in renamed:
            image.name = names[image.image_id - 1]
            db.update_image(image)


def matching_summary(database: Path) -> dict[str, tuple[int, int]]:
    """For every image of the database: its number of features, and of inliers in its best pair."""
    with pycolmap.Database.open(database) as db:
        names = {image.image_id: image.name for image in db.read_all_images()}
        features = {i: db.num_keypoints_for_image(i) for i in names}
        pair_ids, inliers = db.read_two_view_geometry_num_inliers()
    best = dict.fromkeys(names, 0)
    for pair_id, n in zip(pair_ids, inliers, strict=True):
        for i in pycolmap.pair_id_to_image_pair(pair_id):
            best[i] = max(best[i], n)
    return {name: (features[i], best[i]) for i, name in names.items()}
