"""Who publishes on a topic, by the graph of ROS nodes."""

from rclpy.node import Node

UNKNOWN = "a node not known by name yet"  # its publishers are found before it is
SEPARATE = "give each run a namespace or a ROS_DOMAIN_ID of its own"


def publishers(node: Node, topic: str) -> list[str]:
    """Return the full names of the nodes that publish on a topic, one for each publisher."""
    return sorted(
        UNKNOWN
        if "UNKNOWN_" in end.node_name
        else f"{end.node_namespace.rstrip('/')}/{end.node_name}"
        for end in node.get_publishers_info_by_topic(topic)
    )


def several_publishers(node: Node, topic: str) -> str:
    """Say who publishes on a topic that is to have one publisher; empty where only one does.

    A node that was killed counts until the middleware misses it, some 20 s.
    """
    if node.count_publishers(topic) < 2:
        return ""
    return f"several publishers: {topic} of {' and '.join(publishers(node, topic))}; {SEPARATE}"
