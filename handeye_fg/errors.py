"""Every failure that a user can cause or must act on.

``str(error)`` is one sentence: what is wrong, where, what was found, what was wanted, what to do.
"""


class HandEyeError(Exception):
    """Root of the expected failures."""


class InputDataError(HandEyeError):
    """A file, array or option breaks its documented format."""


class ReconstructionError(HandEyeError):
    """Structure from motion registered too little of the images."""


class UnobservableError(HandEyeError):
    """The motions leave so much undetermined that no part of X can be given."""


class ConvergenceError(HandEyeError):
    """The optimiser did not reach a finite optimum."""
