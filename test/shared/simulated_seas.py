"""A simulator node between the odometries that a test publishes and its images."""

import numpy as np
from nav_msgs.msg import Odometry
from odometries import odometry as odometry_message
from odometries import time_of
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image

from uuv_optical_array.nodes.simulator_node import SimulatorNode

BEACON = [-0.7, 0.1, 0.2]
SEED = 11
ABREAST = np.zeros(3), Rotation.identity()
BEHIND = np.array([-5.0, 0.0, 0.0]), Rotation.identity()


def odometry(seconds, place, child="rov/base_link", frame="odom"):
    return odometry_message(round(seconds * 10**9), *place, frame, child)


class Sea:
    """Publishes the odometry of both vehicles and collects the images, of the scene exactly."""

    def __init__(self, lab, scene_file, **parameters):
        self.lab = lab
        exact = {"seed": SEED, "beacon_position_m": BEACON, "draw_sea": False}
        given = exact | parameters
        named = {f"simulator_node:{name}": value for name, value in given.items()}
        lab.begin({"scene": scene_file, **named})
        self.node = lab.start(SimulatorNode)
        self.leader = lab.talk(Odometry, "leader/odometry")
        self.follower = lab.talk(Odometry, "follower/odometry")
        self.images = lab.listen(Image, "array/image")
        lab.connect()

    def image(self, seconds):
        message = self.lab.answer(self.images, time_of(round(seconds * 10**9)), "an image")
        assert (message.encoding, message.width) == ("mono16", 5)
        return np.frombuffer(message.data, "<u2").reshape(message.height, 5)

    def lead(self, seconds, place=ABREAST):
        self.leader.publish(odometry(seconds, place))

    def follow(self, seconds, place=BEHIND, **names):
        self.follower.publish(odometry(seconds, place, **names))

    def look(self, seconds, leader=ABREAST, follower=BEHIND):
        """Publish both poses of one instant and return the image of it."""
        self.lead(seconds, leader)
        self.follow(seconds, follower)
        return self.image(seconds)

    def seconds_answered(self):
        return [image.header.stamp.sec for image in self.images]
