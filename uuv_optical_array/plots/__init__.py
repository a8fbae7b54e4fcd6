"""Every picture of the package: results in, a file out."""

from typing import Any

# What a picture's name may end in, with what keeps the file the same from one run to the next.
KINDS: dict[str, dict[str, Any]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}
