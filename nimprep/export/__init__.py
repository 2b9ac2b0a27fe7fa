"""Write a store's frames out as files that other programs read."""

from nimprep.export.formats import FORMATS, export_frames

__all__ = ["FORMATS", "export_frames"]
