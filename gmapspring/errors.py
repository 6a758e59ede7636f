"""Errors of the package: every one says what is wrong, which item is the culprit, and the way out."""


class GmapspringError(Exception):
    """Base of every error that the package raises on purpose."""


class MeshError(GmapspringError, ValueError):
    """A mesh or mesh file that cannot become a body."""


class TopologyError(GmapspringError, ValueError):
    """A cut or suture that the map refuses; the body is unchanged."""


class StabilityError(GmapspringError, ValueError):
    """A time step above the proven stable step."""


class DivergenceError(GmapspringError, RuntimeError):
    """A state that stopped being finite; the last finite state is kept."""


class StateFileError(GmapspringError, ValueError):
    """A saved state that is foreign, truncated, or of another version."""


class ConfigError(GmapspringError, ValueError):
    """A configuration with one or more mistakes, all listed."""


class CapacityError(GmapspringError, ValueError):
    """A body that may come to need more nodes or springs than its row of a batch has room for."""
