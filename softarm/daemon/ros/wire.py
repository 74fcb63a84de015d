"""Keys, liveliness tokens and attachments of rmw_zenoh.

Format: the design document, liveliness_utils.cpp and attachment_helpers.cpp of ros2/rmw_zenoh.
"""

import hashlib
from typing import NamedTuple

import zenoh
from zenoh.ext import Int64, z_serialize

PUBLISHER, SUBSCRIPTION = "MP", "MS"
# Reliable, volatile, the last ten; a field left out has the default of rmw_zenoh.
QOS = "::,10:,:,:,,"


class Topic(NamedTuple):
    """A topic with its message type."""

    name: str  # qualified, without the first slash: softarm/tip
    type_name: str  # geometry_msgs/msg/PoseStamped
    type_hash: str  # RIHS01_...

    @property
    def _path(self) -> tuple[str, str]:
        package, kind, name = self.type_name.split("/")
        return f"{package}::{kind}::dds_::{name}_", self.type_hash

    def key(self, domain: int) -> str:
        """Return the key expression of the topic's messages."""
        return "/".join((str(domain), self.name, *self._path))


class Node(NamedTuple):
    """The only node of a Zenoh session, in the root namespace."""

    domain: int
    session: str  # id of the Zenoh session
    name: str

    @property
    def token(self) -> str:
        """Return the liveliness token by which ROS 2 knows the node."""
        return self._token("0", "NN")

    def endpoint(self, number: int, kind: str, topic: Topic) -> str:
        """Return the liveliness token of the node's publisher or subscription with this number."""
        mangled = f"/{topic.name}".replace("/", "%")
        return "/".join((self._token(str(number), kind), mangled, *topic._path, QOS))

    def _token(self, number: str, kind: str) -> str:
        return f"@ros2_lv/{self.domain}/{self.session}/0/{number}/{kind}/%/%/{self.name}"


def attachment(sequence: int, source_ns: int, token: str) -> zenoh.ZBytes:
    """Return a message's attachment: its number, its time in ns since 1970, and the publisher's 16-byte id.

    rmw_zenoh hashes the token with XXH3; receivers need only an id that differs between publishers.
    """
    gid = hashlib.blake2b(token.encode(), digest_size=16).digest()
    return z_serialize((Int64(sequence), Int64(source_ns), gid))
