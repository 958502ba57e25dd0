"""The fit. Its compiled code is cached by what all of its files say."""

import hashlib
from pathlib import Path

from numba import config

_FOLDER = Path(__file__).parent
_CODE = b"".join(path.read_bytes() for path in sorted(_FOLDER.glob("*.py")))
if not config.CACHE_DIR:
    # Numba looks at a function's own file alone: what it inlines from another would stay as it was
    config.CACHE_DIR = str(_FOLDER / "__pycache__" / hashlib.sha256(_CODE).hexdigest()[:16])
