"""Hold the solvers against the baselines of KinHEC, on its own data and under its protocol.

    python benchmarks/kinhec.py [--tier small] [--seed N] [--tracks ...] [--workers 2] [--output DIR]

Generates a tier of the package ``kinhec`` (A. Aiersilan, MIT licence) with its seed or another one,
and evaluates every sequence of the tracks. Protocol: keyframes of the measured streams at least 5
degrees or 2 cm apart, at most 200. The package feeds its A X = X B baselines consecutive motions of
the keyframes and its A X = Z B baselines the keyframes; the solvers here get the keyframes and choose
their own pairs. Errors are medians over the sequences of a track: geodesic angle and distance of X,
relative error of the scale. A sequence that a solver refuses counts as an infinite error.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

# This file has the package's name: without this line it would import itself.
sys.path[:] = [entry for entry in sys.path if Path(entry).resolve() != Path(__file__).parent]

import kinhec
import numpy as np
import pandas as pd
import yaml
from kinhec import benchmark, metrics, motions
from kinhec.pipeline import generate_dataset
from kinhec.plans import load_tier

import handeye_fg as hf

METRIC = ("tsai_lenz", "daniilidis", "horaud_dornaika", "andreff", "park_martin", "shah", "li")
UP_TO_SCALE = ("andreff_scale", "pose_graph")
TRACKS = ("noise", "motion", "outliers", "monocular")


def generated(tier, seed, tracks, folder, workers):
    """The folder of a tier, generated once."""
    spec = {key: value for key, value in load_tier(tier).items() if not key.startswith("_")}
    spec["global_seed"] = spec["global_seed"] if seed is None else seed
    root = folder / f"{tier}-{spec['global_seed']}"
    root.mkdir(parents=True, exist_ok=True)
    recipe = root / "tier.yaml"
    recipe.write_text(yaml.safe_dump(spec, sort_keys=False))
    generate_dataset(
        str(recipe), root, workers=workers, tracks=list(tracks), work_dir=root / "work"
    )
    return root


def keyframes(sequence):
    """Absolute keyframe poses A, B (A X = Y B) as the protocol selects them."""
    A, B = sequence.axyb_poses()
    index = motions.select_keyframes(
        A,
        benchmark.KEYFRAME_MIN_ROT_DEG,
        benchmark.KEYFRAME_MIN_TRANS_M,
        benchmark.MAX_KEYFRAMES,
    )
    index = index if len(index) >= 3 else np.arange(len(A))
    return A[index], B[index]


def answer(method, sequence, *, monocular):
    """X, and the scale of the measured translations over the metric ones, by one of our methods."""
    A, B = keyframes(sequence)
    if method == "pose_graph" and not sequence.eye_in_hand:
        # There X is the marker on the flange, here it is the static camera (Y there).
        result = hf.solve(A, np.linalg.inv(B), method, setup="eye-to-hand", metric=True)
        return result.base_T_world, 1.0
    result = hf.solve(A, B, method, metric=not monocular)
    return result.matrix, 1.0 / result.metres_per_world_unit


def evaluated(job):
    """One row for each solver on one sequence."""
    root, identity, seed = job
    manifest = kinhec.load_manifest(root)
    sequence = kinhec.load_sequence(root, identity, manifest)
    track = sequence.manifest["track"]
    rng = np.random.default_rng(seed)
    rows = benchmark.evaluate_sequence(sequence, list(benchmark.SOLVERS), rng=rng)
    rows = [row | {"solver": f"kinhec {row['solver']}"} for row in rows]
    monocular = track == "monocular"
    for method in UP_TO_SCALE if monocular else (*METRIC, "pose_graph"):
        row = {"sequence_id": identity, "track": track, "solver": method, "ok": False}
        try:
            X, scale = answer(method, sequence, monocular=monocular)
        except hf.HandEyeError as error:
            row["error"] = str(error)
        else:
            row |= metrics.calibration_errors(X, sequence.X) | {"ok": True}
            if monocular:
                row["scale_err_rel"] = abs(scale / sequence.scale - 1.0)
        rows.append(row)
    return rows


def table(rows, track):
    """Medians of a track, best translation first, as Markdown."""
    lines = [
        "| solver | answered | rotation deg | translation mm | scale % |",
        "|---|---|---|---|---|",
    ]
    errors = ["X_rot_err_deg", "X_trans_err_mm", "scale_err_rel"]
    of_track = rows[rows["track"] == track].copy()
    of_track.loc[~of_track["ok"], errors[:2]] = np.inf
    by_solver = of_track.groupby("solver")
    counts = by_solver["ok"].agg(["sum", "size"])
    for solver, median in by_solver[errors].median().sort_values("X_trans_err_mm").iterrows():
        scale = 100.0 * median["scale_err_rel"]
        lines.append(
            f"| {solver} | {counts.loc[solver, 'sum']}/{counts.loc[solver, 'size']} "
            f"| {median['X_rot_err_deg']:.3f} | {median['X_trans_err_mm']:.2f} "
            f"| {'' if np.isnan(scale) else f'{scale:.2f}'} |"
        )
    return "\n".join(lines)


def main():
    """Print one table for each track."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--tier", default="small")
    parser.add_argument("--seed", type=int, help="of the generator; default: the tier's own")
    parser.add_argument("--tracks", nargs="+", default=TRACKS, choices=TRACKS)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path, default=Path("out/kinhec"))
    arguments = parser.parse_args()
    root = generated(
        arguments.tier, arguments.seed, arguments.tracks, arguments.output, arguments.workers
    )
    manifest = kinhec.load_manifest(root, list(arguments.tracks))
    jobs = [(root, identity, k) for k, identity in enumerate(manifest["sequence_id"])]
    with ProcessPoolExecutor(arguments.workers) as pool:
        rows = pd.DataFrame([row for rows in pool.map(evaluated, jobs) for row in rows])
    rows.to_csv(root / "results.csv", index=False)
    for track in arguments.tracks:
        print(f"\n### {track}, {root.name}\n\n{table(rows, track)}")


if __name__ == "__main__":
    main()
