"""Decode one image file, with every doubt about it turned into a `DecodeError`.

PNG, JPEG, TIFF, BMP, WebP, PNM and PFM through OpenCV; arrays in .npy and .npz and bare numbers
through NumPy; HDF5 and MATLAB 7.3 through h5py; EXR through OpenEXR. What an image claims to
be is read here, before OpenCV sees it (PNG and JPEG strictly, the others by Pillow's parsers): a
size that cannot be costs no memory, what is cut or damaged is named, and decoders of formats that
nobody needs here get no input at all.

The libraries below OpenCV (libpng, libjpeg) print some complaints on the process's stderr. What
they would complain of in files that are cut or damaged by accident is found here first; in files
made to deceive it is not, and their line then stands beside ours. File descriptor 2 belongs to the
whole process, so that holding it back around a decode would swallow other threads' lines too.
"""

from nimprep.images.archive import archive_shapes
from nimprep.images.array import read_array, read_array_header
from nimprep.images.decode import read_bytes, read_depth, read_label, read_rgb
from nimprep.images.hdf5 import hdf5_cell_count, hdf5_shapes, read_hdf5_cell
from nimprep.images.header import ImageHeader
from nimprep.images.layout import Layout, Raw
from nimprep.images.orientation import OrientationRule, read_orientation
from nimprep.images.plane import read_header, read_plane

__all__ = [
    "ImageHeader",
    "Layout",
    "OrientationRule",
    "Raw",
    "archive_shapes",
    "hdf5_cell_count",
    "hdf5_shapes",
    "read_array",
    "read_array_header",
    "read_bytes",
    "read_depth",
    "read_hdf5_cell",
    "read_header",
    "read_label",
    "read_orientation",
    "read_plane",
    "read_rgb",
]
