"""Image observations linearised, and their points eliminated; entry points ``batches``, ``eliminate``.

A point shares no measurement with another one, so that batches of points are eliminated
independently, at the same time. With C the whitened derivatives by the cameras (transposed), P those
by the points, e the whitened errors and K those by the intrinsics, and with Q = P L^-T where
P'P = L L', the normal equations without the points are::

    cameras and cameras:      C C' - Y Y',       Y = C Q
    cameras and E = [K, -e]:  C E - Y (Q'E)
    E and E:                  E'E - (Q'E)'(Q'E)

C, P, Q and Y consist of small dense blocks, one for each observation.
"""

import itertools
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from handeye_fg.errors import ConvergenceError
from handeye_fg.frames import Array
from handeye_fg.graph.reduced import Layout, Quadratic
from handeye_fg.graph.reprojection import derivatives, errors
from handeye_fg.graph.variables import State
from handeye_fg.types import Indices, Tracks

# Observations in a batch: few, since each needs a kilobyte while the batch is at work, but no fewer than
# there are pairs of images, so that adding up the batches' matrices costs less than making them.
_BATCH = 16_000
_FEWEST_BATCHES = 2  # one for each of two cores
# Part of the largest element; of two lines of sight at an angle of 0.01 it is 1e-4.
_SINGULAR = 1e-12
_SLABS = 4  # of a symmetric product: 5/8 of it are computed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Batch:
    """Observations of a range of points, in the order of the points.

    Attributes:
        image: index (m,) of the image.
        point: index (m,) of the point, from the first of the range.
        pixels: observed (m, 2).
        sigmas: standard deviations (m,), pixels.
        points: the range.
        camera_order: the observations (m,) in the order of the images.
        camera_start: where those of each image start (n + 1,).
    """

    image: NDArray[np.int32]
    point: NDArray[np.int32]
    pixels: Array
    sigmas: Array
    points: slice
    camera_order: NDArray[np.int32]
    camera_start: NDArray[np.int32]


def _batch(tracks: Tracks, sigmas: Array, rows: Indices, n_images: int, points: slice) -> Batch:
    """The observations ``rows``, which are those of ``points`` in their order."""
    image = tracks.image_index[rows].astype(np.int32)
    order = np.argsort(image, kind="stable").astype(np.int32)
    return Batch(
        image=image,
        point=(tracks.point_index[rows] - points.start).astype(np.int32),
        pixels=tracks.pixels[rows],
        sigmas=sigmas[rows],
        points=points,
        camera_order=order,
        camera_start=np.searchsorted(image[order], np.arange(n_images + 1)).astype(np.int32),
    )


def batches(tracks: Tracks, sigmas: Array, n_images: int, n_known: int) -> tuple[Batch, ...]:
    """The observations of the unknown points, divided.

    Args:
        tracks: all observations; each unknown point has one or more.
        sigmas: their standard deviations (m,), pixels.
        n_images: number of images.
        n_known: the first so many points are not eliminated.
    """
    order = np.argsort(tracks.point_index, kind="stable")
    order = order[np.searchsorted(tracks.point_index[order], n_known) :]
    if len(order) == 0:
        return ()
    count = max(_FEWEST_BATCHES, -(-len(order) // max(_BATCH, n_images**2)))
    cuts = tracks.point_index[order[len(order) * np.arange(1, count) // count]]
    edges = np.unique([n_known, *cuts, len(tracks.points_world)])
    starts = np.searchsorted(tracks.point_index[order], edges)
    return tuple(
        _batch(tracks, sigmas, order[a:b], n_images, slice(int(first), int(last)))
        for a, b, first, last in zip(starts[:-1], starts[1:], edges[:-1], edges[1:], strict=True)
    )


def corner_batch(tracks: Tracks, sigmas: Array, n_images: int, n_known: int) -> Batch:
    """The observations of the first ``n_known`` points, which are known."""
    rows = np.flatnonzero(tracks.point_index < n_known)
    rows = rows[np.argsort(tracks.point_index[rows], kind="stable")]
    return _batch(tracks, sigmas, rows, n_images, slice(0, n_known))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Back:
    """The way from the shared unknowns back to the points of a batch."""

    y: sparse.bsr_array
    q_others: Array
    inverse_root: Array

    def point_steps(self, cameras: Array, others: Array) -> Array:
        """Steps (p, 3) that belong to steps of the cameras and of E's columns."""
        rest = self.q_others @ others - self.y.T @ cameras
        return np.asarray((rest.reshape(-1, 1, 3) @ self.inverse_root)[:, 0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Part:
    """What a batch says of the shared unknowns.

    Attributes:
        cameras: normal equations of the cameras, at least on and below the diagonal: a sum of
            matrices of blocks, each with the row of blocks at which it starts.
        cameras_others: those of the cameras and E.
        others: those of E.
        back: the way back to the points.
    """

    cameras: tuple[tuple[int, sparse.bsr_array], ...]
    cameras_others: Array
    others: Array
    back: _Back


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Eliminated:
    """The cost of the observations of unknown points, with these points at their best."""

    quadratic: Quadratic
    back: Sequence[_Back]
    layout: Layout

    def point_steps(self, step: Array) -> Array:
        """Steps (p, 3) of the eliminated points that belong to a step (d,) of the shared unknowns."""
        cameras = step[: 6 * self.layout.n_poses]
        others = np.append(-step[self.layout.intrinsics_columns], 1.0)
        steps = [batch.point_steps(cameras, others) for batch in self.back]
        return np.concatenate([np.zeros((0, 3)), *steps])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Whitened:
    """C, P's blocks, and E = [K, -e] of a batch."""

    by_cameras: sparse.bsr_array
    by_point: Array
    others: Array


def _whitened(
    batch: Batch, state: State, layout: Layout, mute: NDArray[np.bool_] | None = None
) -> _Whitened:
    """What a batch says, but for observations (m,) that are not to say anything."""
    found = derivatives(
        state,
        batch.image,
        batch.point + batch.points.start,
        batch.pixels,
        layout.intrinsics,
    )
    weight = 1.0 / batch.sigmas
    m, n = len(weight), layout.n_poses
    others = np.concatenate([found.by_intrinsics, -found.errors[:, :, None]], axis=2)
    others *= weight[:, None, None]
    if mute is not None:
        weight[mute], others[mute, :, :-1] = 0.0, 0.0
    by_pose = (found.by_pose * weight[:, None, None])[batch.camera_order]
    return _Whitened(
        by_cameras=sparse.bsr_array(
            (by_pose.transpose(0, 2, 1).copy(), batch.camera_order, batch.camera_start),
            shape=(6 * n, 2 * m),
        ),
        by_point=found.by_point * weight[:, None, None],
        others=others.reshape(2 * m, len(layout.intrinsics_columns) + 1),
    )


def squares(parts: Sequence[Batch], state: State) -> float:
    """Sum of the squared whitened errors of observations."""
    total = 0.0
    for part in parts:
        found = errors(state, part.image, part.point + part.points.start, part.pixels)
        total += float(np.sum((found / part.sigmas[:, None]) ** 2))
    return total


def _by_points(blocks: Array, batch: Batch, n_points: int) -> sparse.bsr_array:
    """Blocks (m, 2, 3) as a matrix (2 m, 3 p)."""
    m = len(blocks)
    rows = np.arange(m + 1, dtype=np.int32)
    return sparse.bsr_array((blocks, batch.point, rows), shape=(2 * m, 3 * n_points))


def _separated(
    batch: Batch, state: State, layout: Layout
) -> tuple[_Whitened, sparse.bsr_array, Array]:
    """What a batch says, and Q and L^-1 (p, 3, 3) of its derivatives by the points.

    Observations of a point that they do not determine, since all of its cameras but one have it behind
    them, say nothing.
    """
    whitened = _whitened(batch, state, layout)
    V = _of_points(whitened, batch)
    lost = _singular(V)
    if lost.any():
        whitened = _whitened(batch, state, layout, lost[batch.point])
        V[lost] = np.eye(3)
    root = np.linalg.cholesky(V)
    inverse_root = np.asarray(np.linalg.inv(root), dtype=np.float64)
    blocks = whitened.by_point @ np.swapaxes(inverse_root, 1, 2)[batch.point]
    return whitened, _by_points(blocks, batch, len(V)), inverse_root


def _singular(V: Array) -> NDArray[np.bool_]:
    """Which symmetric matrices (p, 3, 3) are singular but for rounding."""
    try:
        pivots = np.linalg.cholesky(V).diagonal(axis1=1, axis2=2) ** 2
    except np.linalg.LinAlgError:
        pivots = np.linalg.eigvalsh(V)
    largest = V.diagonal(axis1=1, axis2=2).max(axis=1)
    return np.asarray(pivots.min(axis=1) <= _SINGULAR * largest)


def _of_points(whitened: _Whitened, batch: Batch) -> Array:
    """P'P: a block (p, 3, 3) for each point of a batch."""
    n_points = batch.points.stop - batch.points.start
    squares = np.ascontiguousarray(np.swapaxes(whitened.by_point, 1, 2)) @ whitened.by_point
    return np.asarray(np.add.reduceat(squares, np.searchsorted(batch.point, np.arange(n_points))))


def by_regions(
    parts: Sequence[Batch], state: State, layout: Layout, directions: Array, region: Indices
) -> tuple[Array, Array]:
    """What the unknown points of each region of the scene say along some directions.

    It is what ``eliminate`` gives for the region, times the directions, without its large matrix.

    Args:
        parts: the observations.
        state: where to linearise.
        layout: of the shared unknowns, with a pose for each image.
        directions: steps (d, q) of the shared unknowns.
        region: index of the region of each point; those of known points do not matter.

    Returns:
        For each region (b) the information times the directions (b, d, q), and the gradient (b, d).
    """
    n, intrinsics, count = 6 * layout.n_poses, layout.intrinsics_columns, int(region.max()) + 1
    found = np.zeros((count, layout.dim, directions.shape[1] + 1))
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        for cameras, others in pool.map(
            lambda batch: _by_regions(batch, state, layout, directions, region, count), parts
        ):
            found[:, :n] += cameras
            found[:, intrinsics] += others
    return found[:, :, :-1], found[:, :, -1]


def _by_regions(
    batch: Batch, state: State, layout: Layout, directions: Array, region: Indices, count: int
) -> tuple[Array, Array]:
    """Rows of the cameras (b, 6 n, q + 1) and of the intrinsics of what a batch says."""
    whitened, Q, _ = _separated(batch, state, layout)
    n, m = layout.n_poses, len(batch.image)
    by_intrinsics, errors = whitened.others[:, :-1], whitened.others[:, -1]
    along = whitened.by_cameras.T @ directions[: 6 * n]
    along += by_intrinsics @ directions[layout.intrinsics_columns]
    rest = np.column_stack([along, errors])
    rest = (rest - Q @ (Q.T @ rest)).reshape(m, 2, -1)
    theirs = region[batch.point + batch.points.start]

    def summed(rows: Array, bins: Indices, n_bins: int) -> Array:
        add = sparse.csr_array((np.ones(m), (bins, np.arange(m))), shape=(n_bins, m))
        return np.asarray(add @ rows.reshape(m, -1)).reshape(n_bins, *rows.shape[1:])

    # The blocks of the cameras are in the order of the images.
    order = batch.camera_order
    cameras = summed(
        whitened.by_cameras.data @ rest[order], theirs[order] * n + batch.image[order], count * n
    )
    others = summed(np.swapaxes(by_intrinsics.reshape(m, 2, -1), 1, 2) @ rest, theirs, count)
    return cameras.reshape(count, 6 * n, -1), others


def _eliminated(batch: Batch, state: State, layout: Layout) -> _Part:
    """Linearise a batch and eliminate its points."""
    whitened, Q, inverse_root = _separated(batch, state, layout)
    C, E = whitened.by_cameras, whitened.others
    Y, q_others = C @ Q, Q.T @ E
    return _Part(
        cameras=((0, C @ C.T), *_lower_square(Y)),
        cameras_others=C @ E - Y @ q_others,
        others=E.T @ E - q_others.T @ q_others,
        back=_Back(y=Y, q_others=q_others, inverse_root=inverse_root),
    )


def _lower_square(y: sparse.bsr_array) -> Iterator[tuple[int, sparse.bsr_array]]:
    """-Y Y' without most of what is above its diagonal: slabs of block rows, from the first on."""
    n, width = len(y.indptr) - 1, y.shape[1]
    edges = np.unique(np.arange(_SLABS + 1) * n // _SLABS)
    for start, stop in itertools.pairwise(edges.tolist()):
        first, last = y.indptr[start], y.indptr[stop]
        slab = sparse.bsr_array(
            (y.data[first:last], y.indices[first:last], y.indptr[start : stop + 1] - first),
            shape=(6 * (stop - start), width),
        )
        left = sparse.bsr_array(
            (y.data[:last], y.indices[:last], y.indptr[: stop + 1]), shape=(6 * stop, width)
        )
        yield start, -(slab @ left.T)


def eliminate(parts: Sequence[Batch], state: State, layout: Layout) -> Eliminated:
    """Linearise the observations of unknown points and eliminate these points.

    Args:
        parts: the observations.
        state: where to linearise.
        layout: of the shared unknowns, with a pose for each image.

    Raises:
        ConvergenceError: derivatives are not finite.
    """
    n, intrinsics = 6 * layout.n_poses, layout.intrinsics_columns
    hessian, cameras_others = np.zeros((layout.dim, layout.dim)), np.zeros((n, len(intrinsics) + 1))
    others = np.zeros((len(intrinsics) + 1, len(intrinsics) + 1))
    back = []
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        try:
            # In the order of the batches: the sums are the same in every run.
            for one in pool.map(lambda batch: _eliminated(batch, state, layout), parts):
                for first_row, blocks in one.cameras:
                    _add_blocks(hessian, first_row, blocks)
                cameras_others += one.cameras_others
                others += one.others
                back.append(one.back)
        except np.linalg.LinAlgError as error:
            raise ConvergenceError(
                "the joint refinement diverged: its derivatives are not finite; check the robot poses and "
                "the reconstruction"
            ) from error
    hessian = np.tril(hessian)
    hessian += np.tril(hessian, -1).T
    hessian[:n, intrinsics] = cameras_others[:, :-1]
    hessian[intrinsics, :n] = cameras_others[:, :-1].T
    hessian[np.ix_(intrinsics, intrinsics)] = others[:-1, :-1]
    gradient = np.zeros(layout.dim)
    gradient[:n], gradient[intrinsics] = cameras_others[:, -1], others[:-1, -1]
    quadratic = Quadratic(hessian=hessian, gradient=gradient, constant=float(others[-1, -1]))
    return Eliminated(quadratic=quadratic, back=back, layout=layout)


def _add_blocks(hessian: Array, first_row: int, blocks: sparse.bsr_array) -> None:
    """Add blocks (6, 6) in place, from a row of blocks on, without unfolding their matrix."""
    columns = blocks.shape[1]
    for i, (start, stop) in enumerate(itertools.pairwise(blocks.indptr.tolist()), first_row):
        row = hessian[6 * i : 6 * i + 6, :columns].reshape(6, columns // 6, 6)
        row[:, blocks.indices[start:stop]] += blocks.data[start:stop].transpose(1, 0, 2)


def corners_quadratic(batch: Batch, state: State, layout: Layout) -> Quadratic:
    """The cost of the observations of known points, which stay among the unknowns."""
    whitened = _whitened(batch, state, layout)
    n_rows = 2 * len(batch.sigmas)
    # X, Z and the scale
    between = layout.first_intrinsics - 6 * layout.n_poses
    jacobian = sparse.hstack(
        [
            whitened.by_cameras.T,
            sparse.csr_array((n_rows, between)),
            sparse.csr_array(whitened.others[:, :-1]),
            _by_points(whitened.by_point, batch, layout.n_known),
        ],
        format="csr",
    )
    errors = whitened.others[:, -1]
    return Quadratic(
        hessian=(jacobian.T @ jacobian).toarray(),
        gradient=np.asarray(jacobian.T @ errors),
        constant=float(errors @ errors),
    )
