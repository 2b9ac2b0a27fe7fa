"""Write a store's frames out as files that other programs read."""

from nimprep.export.run import FORMATS, export_frames

__all__ = ["FORMATS", "export_frames"]
