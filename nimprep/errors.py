"""What can go wrong with a user's data, each kind as its own exception.

Every message is one line: ``<path or frame>: expected <X>, found <Y>; <next step>``. The command
line prints it and exits 1; anything that is not a `NimprepError` is a bug and keeps its traceback.
"""


class NimprepError(Exception):
    """Base of every error that is the data's fault or the environment's, not the program's.

    Attributes
    ----------
    frame_id : str, optional
        The frame that ended a conversion, where one did.
    """

    frame_id: str | None = None


class LayoutError(NimprepError, FileNotFoundError):
    """A raw dataset lacks a folder or a file, or its files do not belong together."""

    # FileNotFoundError would format (errno, text) pairs; the message stands alone here.
    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class OptionError(LayoutError):
    """An option that the dataset's reader does not take: the call is wrong, not the data."""


class DecodeError(NimprepError, ValueError):
    """A file is there but is not what it should be: truncated, of another type or out of range."""


class ArrayError(NimprepError, ValueError):
    """An array handed to a public function has the wrong shape, dtype or values."""


class CameraError(NimprepError, ValueError):
    """A camera's numbers make no pinhole camera, or do not belong to the image."""


class StoreError(NimprepError, ValueError):
    """A store is missing, incomplete, damaged, of another version, or cannot be written."""


class TrainingError(NimprepError, RuntimeError):
    """A training cannot go on as it was asked for: no memory is left, or the numbers ran away."""


class ClusterError(NimprepError, ConnectionError):
    """A Dask cluster is out of reach, or its workers cannot do the work."""


class CacheError(NimprepError, OSError):
    """Compiled kernels cannot be kept anywhere."""


class SplitError(NimprepError, ValueError):
    """A split file or rule does not fit the frames."""


class DoubtWarning(UserWarning):
    """A data set is perhaps read wrongly: `warnings.filterwarnings` makes it an error."""


class FindingWarning(UserWarning):
    """What was made of a data set tells less than it seems: normals that are noise, say.

    Unlike with a `DoubtWarning`, nothing need be read wrongly.
    """


class DepthLossWarning(DoubtWarning):
    """Depth of a data set is none in its store, whose unit cannot say it."""
