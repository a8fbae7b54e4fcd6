"""From the image of the array to its five key parameters."""

import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeAlias

from rclpy.node import Node
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.messages import image_from_message, stamp_ns
from uuv_optical_array.estimation.signature.daylight import Daylight
from uuv_optical_array.estimation.signature.faint_light import FaintLight
from uuv_optical_array.estimation.signature.features import (
    FeatureSettings,
    no_pattern,
    scene_parameters,
)
from uuv_optical_array.estimation.signature.plausibility import check_full_scale
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.shared import messages
from uuv_optical_array.nodes.shared.diagnostics import Diagnostics
from uuv_optical_array.nodes.shared.node import publish, run, subscribe
from uuv_optical_array.nodes.shared.parameters import Parameters, parameters_of, shared
from uuv_optical_array.nodes.shared.rest import Rest

HandOver: TypeAlias = Callable[[Header, Array, Callable[[], Array | None]], None]

PARAMETERS = {**shared("scene"), **parameters_of(FeatureSettings)}


class FeatureNode(Node):
    """Publish one point of five fields for each image; no point where there is no light.

    The point of light that came in some seconds, and that one image does not show, is in a topic of
    its own. `hand_over` takes header, counts, and what returns the key parameters or ``None``, of
    each image at once; then only the newest of the images that wait is served, and what it does not
    ask for comes afterwards: `look` takes header, key parameters and those of the faint light or
    ``None``, and they are published.
    """

    def __init__(
        self,
        hand_over: HandOver | None = None,
        look: Callable[[Header, Array | None, Array | None], None] | None = None,
        **options: Any,
    ) -> None:
        super().__init__("feature_node", **options)
        self.parameters = Parameters(self, PARAMETERS)
        self.scene = load_scene(self.parameters["scene"])
        self.daylight = Daylight(ForwardModel(self.scene))
        self.order = messages.StampOrder()
        self.diagnostics = Diagnostics(self)
        self.faint_light = FaintLight(self.scene.array.detectors_per_side)
        self.features = publish(self, PointCloud2, "array/features")
        self.faint_features = publish(self, PointCloud2, "array/faint_features")
        self.hand_over, self.look, self.rest = hand_over, look, Rest(self)
        subscribe(self, Image, "array/image", self.on_image, newest=hand_over is not None)

    def on_image(self, message: Image) -> None:
        """Answer one image."""
        self.rest.finish()
        with self.diagnostics.refusing():
            self.order.check(message.header, self.get_clock().now().nanoseconds)
            image = image_from_message(message, self.scene.array, self.scene.lamp_count)
            features = cache(partial(self.key_parameters, image))
            if self.hand_over is None:
                self.tell(message.header, image, features)
            else:
                self.hand_over(message.header, image, features)
                self.rest.leave(partial(self.tell, message.header, image, features))

    def tell(self, header: Header, image: Array, features: Callable[[], Array | None]) -> None:
        """Publish the key parameters of an image."""
        with self.diagnostics.refusing():
            parameters, faint = features(), None
            if parameters is None:
                came = self.faint_light.look(1e-9 * stamp_ns(header), together(image))
                faint = None if came is None else scene_parameters(came, self.scene)
            if self.look is not None:
                self.look(header, parameters, faint)
            if self.features.heard:
                self.features.publish(messages.features_to_message(parameters, header))
            if faint is not None and self.faint_features.heard:
                self.faint_features.publish(messages.features_to_message(faint, header))
            if parameters is not None:
                self.diagnostics.answer(stamp_ns(header), lambda: self.figures(image))

    def key_parameters(self, image: Array) -> Array | None:
        """Return those of an image, shape ``(5,)``; ``None`` and a refusal without light."""
        check_full_scale(float(image.max()), self.scene)
        least = self.parameters["min_peak_counts"] + self.scene.black_counts
        no_light = no_pattern(image, least)
        if not no_light and self.daylight.explains(image):
            no_light = f"no light: daylight alone may read {image.max():g} counts"
        if no_light:
            self.diagnostics.refuse(no_light)
            return None
        return scene_parameters(image, self.scene)

    def figures(self, image: Array) -> dict[str, str]:
        """Return what the diagnostics show of an image."""
        full = self.scene.full_scale_counts
        return {
            "peak_counts": f"{image.max():g}",
            "light_level": f"{image.max() / full:.3f}",
            "saturated_share": f"{(image >= math.floor(full)).mean():.3f}",
        }


main = partial(run, FeatureNode)
