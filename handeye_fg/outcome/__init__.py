"""From the stages' answers to the result that users get, in figures, words and pictures; entry point ``assemble``."""

from handeye_fg.outcome.assembly import assemble, require_agreement

__all__ = ["assemble", "require_agreement"]
