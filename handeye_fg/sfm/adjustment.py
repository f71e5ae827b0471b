"""Bundle adjustment of a whole reconstruction; entry point ``adjust``."""

import pycolmap

from handeye_fg.sfm.native import run_cancellable


def adjust(
    reconstruction: pycolmap.Reconstruction, options: pycolmap.BundleAdjustmentOptions, what: str
) -> None:
    """Adjust cameras and points to all placed images, in one thread: the same result in every run.

    Args:
        reconstruction: changed in place, with the errors of its points.
        options: what is refined, and the loss.
        what: what this is part of, for error messages.

    Raises:
        ReconstructionError: COLMAP failed.
    """
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in reconstruction.reg_image_ids():
        config.add_image(image_id)
    if options.refine_rig_from_world:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    # Not pycolmap.bundle_adjustment: that turns COLMAP's log on.
    adjuster = pycolmap.create_default_bundle_adjuster(options, config, reconstruction)
    run_cancellable(lambda _: adjuster.solve(), what, lambda: None)
    reconstruction.update_point_3d_errors()
