"""How many threads linear algebra uses; ``one_blas_thread``."""

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it has no types


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS and LAPACK to one thread; a context and a decorator.

    Its threads wait for each other actively, a hundred times in one factorisation. On cores that other
    processes use as well, a matrix of 600 rows took 0.6 s with two threads and 0.02 s with one. What
    is large is divided among threads of our own.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
