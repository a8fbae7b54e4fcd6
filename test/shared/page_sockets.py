"""What a browser has of the live view: the messages of viser, by WebSocket."""

from urllib.parse import urlsplit

import msgspec.msgpack  # it, websockets and zstandard come with viser
import viser
import zstandard
from websockets.sync.client import connect


def socket_of(url, path=None, **options):
    """Connect to a page as its own JavaScript does, but for what the options say."""
    address = urlsplit(url)
    return connect(
        f"ws://{address.netloc}{address.path if path is None else path}",
        subprotocols=[f"viser-v{viser.__version__}"],
        compression=None,
        max_size=None,
        **options,
    )


def messages_in(frame):
    """Return the messages of a frame, which a page applies at once."""
    packed = frame[16 : 16 + int.from_bytes(frame[8:16], "little")]
    return msgspec.msgpack.decode(zstandard.decompress(packed))["messages"]
