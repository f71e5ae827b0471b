"""The factor graph: measurements, joint refinement, noise levels and covariance; see ``refine``."""
