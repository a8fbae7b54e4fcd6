"""A probe that asks an estimator node over DDS, and compares its answers with the core's."""

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion
from nav_msgs.msg import Odometry
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image, Imu, PointCloud2
from std_msgs.msg import Header

from uuv_optical_array.core.geometry import covariance_6x6
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.shared.messages import features_to_message, image_to_message


class Asker:
    """Sends signatures to an estimator node over DDS and compares its poses with the core's."""

    def __init__(self, lab, scene_file, **parameters):
        self.lab = lab
        # Frames of unrelated poses make no track.
        parameters = {"method": "sam", "tracking": False, "use_image": False, **parameters}
        if parameters["method"] == "least_squares":
            parameters["use_image"] = True
        given = {f"estimator_node:{name}": value for name, value in parameters.items()}
        lab.begin({"scene": scene_file, **given})
        self.node = lab.start(EstimatorNode)
        self.clouds = lab.talk(PointCloud2, "array/features")
        self.poses = lab.listen(PoseWithCovarianceStamped, "relative_pose")
        lab.connect()

    def message(self, signature, seconds):
        return features_to_message(
            signature, Header(stamp=Time(sec=seconds, nanosec=9), frame_id="rov/array")
        )

    def ask(self, signature, seconds):
        """Send a signature and return the answer to it."""
        self.clouds.publish(self.message(signature, seconds))
        return self.lab.answer(self.poses, Time(sec=seconds, nanosec=9), "a pose")

    def seconds_answered(self):
        return [pose.header.stamp.sec for pose in self.poses]


def figures(status):
    return [(pair.key, pair.value) for pair in status.values]


def place_of(message):
    position, q = message.pose.pose.position, message.pose.pose.orientation
    return [position.x, position.y, position.z], [q.x, q.y, q.z, q.w]


def twist_of(twist):
    return [getattr(part, axis) for part in (twist.linear, twist.angular) for axis in "xyz"]


def assert_is(message, estimate, roll_std_rad=0.02):
    """Compare a message with an estimate; its attitude by SciPy."""
    position, quaternion = place_of(message)
    np.testing.assert_array_equal(position, estimate.pose[:3])
    _, _, _, pitch, yaw = estimate.pose
    np.testing.assert_allclose(
        Rotation.from_quat(quaternion).as_matrix(),
        Rotation.from_euler("ZYX", [yaw, pitch, 0.0]).as_matrix(),
        atol=1e-12,
    )
    covariance = np.reshape(message.pose.covariance, (6, 6))
    np.linalg.cholesky(covariance)  # fails where it is not positive definite
    expected = covariance_6x6(estimate.pose, estimate.covariance, roll_std_rad)
    np.testing.assert_allclose(covariance, expected, rtol=1e-12, atol=1e-15)


class Shower(Asker):
    """Sends images, and the roll of an IMU; key parameters too where the node needs them."""

    def __init__(self, lab, scene_file, scene, **parameters):
        super().__init__(lab, scene_file, use_image=True, **parameters)
        self.scene = scene
        self.images = lab.talk(Image, "array/image")
        self.imu = lab.talk(Imu, "imu")
        self.tracks = lab.listen(Odometry, "relative_odometry")
        lab.connect()

    def picture(self, image, seconds):
        return image_to_message(image, Header(stamp=Time(sec=seconds, nanosec=9)))

    def signature(self, image):
        return key_parameters(image, self.scene.full_scale_counts, self.scene.signature.peak)

    def send(self, image, seconds, image_first=True):
        """Send an image, and its key parameters."""
        sends = [(self.images, self.picture(image, seconds))]
        if not self.node.fits:
            sends.append((self.clouds, self.message(self.signature(image), seconds)))
        for talker, message in sends if image_first else reversed(sends):
            talker.publish(message)

    def show(self, image, seconds, image_first=True):
        """Send as `send` does, and return the answer."""
        self.send(image, seconds, image_first)
        return self.lab.answer(self.poses, Time(sec=seconds, nanosec=9), "a pose")

    def track(self, seconds):
        return self.lab.answer(self.tracks, Time(sec=seconds, nanosec=9), "a track")

    def tilt(self, roll, seconds):
        """Send an IMU message and wait until the node has it."""
        x, y, z, w = Rotation.from_euler("ZYX", [0.3, 0.1, roll]).as_quat()
        message = Imu(header=Header(stamp=Time(sec=seconds, nanosec=9)))
        message.orientation = Quaternion(x=x, y=y, z=z, w=w)
        self.imu.publish(message)
        self.lab.until(lambda: self.node.roll.stamp_ns == seconds * 10**9 + 9, "the roll")
