"""The page's address and its checks before anything is opened; usable without viser."""

import errno
import socket
from ipaddress import ip_address

from hw.optional_parts import CONSOLE
from scanner.errors import InputError

LOCAL = "127.0.0.1"
DEFAULT_PORT = 8080


def require_viser() -> None:
    """Raise InputError, saying what to install, if viser is not there."""
    with CONSOLE.needed("the page in the browser", "viser", InputError):
        import viser  # noqa: F401  # only now, for most commands do without


def free_port(host: str, wanted: int | None) -> int:
    """The port to serve at. Raises InputError if the wanted one is not to be had, or `host` is not this computer's."""
    if wanted is not None and not 1 <= wanted <= 65535:
        raise InputError(f"--port: expected 1 to 65535, found {wanted}")
    for port in range(wanted or DEFAULT_PORT, (wanted or DEFAULT_PORT + 99) + 1):
        if _is_free(host, port):
            return port
    if wanted is not None:
        raise InputError(f"--port {wanted}: another program uses it; choose another port, or leave --port out")
    raise InputError(f"all ports from {DEFAULT_PORT} on are in use; choose one with --port")


def _is_free(host: str, port: int) -> bool:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except socket.gaierror as error:
        raise InputError(f"--host {host}: no such address: {error.strerror}") from error
    except PermissionError as error:
        raise InputError(
            f"--port {port}: {error.strerror}; ports below 1024 are the system's, choose another"
        ) from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            return False
        raise InputError(f"--host {host}: cannot be served at: {error.strerror}; {LOCAL} always can") from error
    return True


def warning(host: str) -> str:
    """Return a warning about serving at `host`; '' if only this computer can reach it."""
    if is_local(host):
        return ""
    return (
        f"Warning: this page is offered to the network at {host}, unencrypted: whoever learns the address below, with "
        "its token, can press its buttons. Omit --host to keep it private."
    )


def is_local(host: str) -> bool:
    """Whether only programs on this computer reach `host`."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def address(host: str, port: int) -> str:
    """Return the address to open in a browser."""
    try:
        parsed = ip_address(host)
    except ValueError:
        return f"http://{host}:{port}"
    reached = socket.gethostname() if parsed.is_unspecified else f"[{host}]" if parsed.version == 6 else host
    return f"http://{reached}:{port}"
