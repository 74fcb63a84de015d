"""Where the daemon listens."""

import socket


class ApiError(Exception):
    """The API, or the stop's own way, cannot be opened; names the address and the next step."""


def listen(host: str, port: int, key: str, backlog: int) -> socket.socket:
    """A listening TCP socket. key: of the configuration, where the port stands.

    Raises ApiError when the address cannot be bound.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(backlog)
        except OSError:
            listener.close()
            raise
    except OSError as error:
        raise ApiError(
            f"api.host {host}, {key} {port}: cannot listen there ({error.strerror}); stop the program "
            f"that does (another daemon? `softarm status` asks it), or choose another {key}, 0 for any"
        ) from error
    return listener
