"""Images and key parameters as a method needs them, joined by their stamps where it needs both."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image, PointCloud2

from uuv_optical_array.core.messages import stamp_ns
from uuv_optical_array.nodes.shared.node import subscribe, unsubscribe

WAITING = 20  # stamps of which only the image or only the key parameters have come


class ImageInputs:
    """Subscribes to images alone, or to key parameters and, if they are read, images.

    - images: whether images are read at all.
    - on_image: takes an image by itself.
    - on_features: takes key parameters, ``features``, and their image, ``image``, or ``None``.
    - refuse: takes the reason why key parameters get no answer.
    - waiting: by their stamps, what came without the other, by ``features`` or ``image``.
    """

    def __init__(
        self,
        node: Node,
        images: bool,
        on_image: Callable[[Image], None],
        on_features: Callable[..., None],
        refuse: Callable[[str], None],
    ) -> None:
        self._node, self._images = node, images
        self._on_image, self._on_features, self._refuse = on_image, on_features, refuse
        self._subscribed: list[Subscription] = []
        self.waiting: dict[int, dict[str, Any]] = {}

    def listen(self, alone: bool) -> None:
        """Subscribe to images alone or not, in place of what was subscribed to before.

        RuntimeError where ROS is secured and does not allow it; all is as before then.
        """
        before, self._subscribed = self._subscribed, self._subscribing(alone)
        for each in before:
            unsubscribe(self._node, each)
        self.waiting.clear()

    def _subscribing(self, alone: bool) -> list[Subscription]:
        ears: list[Subscription] = []
        take = self._on_image
        if not alone:
            unpack: Callable[..., None] = partial(self._on_features, image=None)
            if self._images:
                unpack, take = partial(self._join, "features"), partial(self._join, "image")
            newest = self._images
            ears = [subscribe(self._node, PointCloud2, "array/features", unpack, newest=newest)]
        if self._images:
            ears.append(subscribe(self._node, Image, "array/image", take, newest=alone))
        return ears

    def _join(self, name: str, message: PointCloud2 | Image) -> None:
        """Answer when key parameters and image of a stamp are there; the oldest stamps leave."""
        stamp = stamp_ns(message.header)
        pair = self.waiting.setdefault(stamp, {})
        pair[name] = message
        if len(pair) == 2:
            self._on_features(**self.waiting.pop(stamp))
        elif len(self.waiting) > WAITING:
            left = self.waiting.pop(next(iter(self.waiting)))
            if "features" in left:
                self._refuse("no image: array/image has none with the features' stamp")
