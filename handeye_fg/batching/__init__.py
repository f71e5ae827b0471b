"""Many data sets: a fleet of robots, every night; entry points ``run.batch`` and ``manifest.DataSet``.

Each calibration is a process of its own (``one``), under a worker of Dask (``task``), so that none harms
another. Workers get the places of data and give back results.
"""
