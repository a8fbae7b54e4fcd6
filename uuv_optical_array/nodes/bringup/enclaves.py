"""The enclave of SROS2 in which an executable runs: of the policy, and given by the launch."""

from uuv_optical_array.core.storage.files import PACKAGE


def enclave(namespace: str, executable: str) -> str:
    """Return the path of an executable's enclave, below that of its namespace, ``/`` or empty."""
    return "/".join(["", PACKAGE, *filter(None, namespace.split("/")), executable])
