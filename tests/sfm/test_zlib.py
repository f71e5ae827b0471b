import subprocess
import sys

CODE = """
import handeye_fg.sfm, io, os, zlib
import numpy as np
for _ in range(20):
    data = os.urandom(200_000)
    assert zlib.decompress(zlib.compress(data, 9)) == data
np.savez_compressed(io.BytesIO(), a=np.zeros(1_000_000))
from matplotlib.figure import Figure
from handeye_fg.report.drawing import Drawing
figure = Figure()
figure.subplots().plot([0, 1])
assert Drawing(name="a", title="", caption="", figure=figure).content("png")[1:4] == b"PNG"
print("sound")
"""


def test_compression_works_beside_colmap() -> None:
    """Its library brings functions of zlib's names; mixed with zlib's own they break the heap."""
    done = subprocess.run(
        [sys.executable, "-c", CODE], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout == "sound\n", done.stderr[-500:]
