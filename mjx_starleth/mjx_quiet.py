"""MJX without the line that it prints on standard output at import, where programs expect only their own JSON."""

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx

__all__ = ["mjx"]
