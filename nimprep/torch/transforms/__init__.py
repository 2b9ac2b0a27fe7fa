"""Augmentations that change every modality of a sample, and its camera, at once.

A *sample* is what a dataset hands to its `transform`, a dict of tensors on the CPU that are not yet
normalised or stacked, with those of these keys that are wanted:

========================= ========================= ================================================
``rgb``, ``hha``          uint8 (3, H, W)
``depth``                 float32 (1, H, W), metres 0 = none
``disparity``             float32 (1, H, W), pixels 0 = none
``transformed_disparity`` float32 (1, H, W), pixels 0 on the road; NaN = none
``elevation``             float32 (1, H, W), metres 0 on the road; NaN = none
``normal``                float32 (3, H, W)         unit vectors; (0, 0, 0) = none
a plane's name            float32 (1, H, W), or     in its units, NaN = none
                          uint8 (1, H, W)
``planes``                dict                      each plane's record by its name, where there
                                                    are any: whoever drops it loses the planes
``label``                 int64 (H, W)              255 = ignore
``intrinsics``            float64 (3, 3), pixels    K
``gravity``               float64 (3,)              direction in the camera frame, pointing down;
                                                    there if the store was given any; NaN = none
``size``                  (height, width)           of the frame itself, at the top left; what lies
                                                    outside is padding
``id``                    str
``generator``             torch.Generator           the sample's own, from which every random number
                                                    is drawn; absent = torch's global one
========================= ========================= ================================================

A transform is a callable from such a dict to such a dict; keys it does not know pass through, and
what it is given is not changed in place. Any callable of one's own may stand among them::

    transform = Compose([RandomScale((0.75, 1.5)), RandomCrop(352, 640), RandomHorizontalFlip(),
                         ColorJitter(0.3, 0.3, 0.3, 0.05), my_own])

Transforms of `torchvision.transforms.v2` and of albumentations 2 may stand there as they are: each
moves all planes with one draw and changes the colours of rgb alone; see `Torchvision`. Within a
function of one's own one of torchvision is called as ``Torchvision(it)(sample)``: given a sample
itself it would move rgb alone, and is refused.

`crop`, `flip`, `resize` and `jitter` are the same without chance.
"""

from nimprep.torch.transforms.color import ColorJitter, jitter
from nimprep.torch.transforms.composition import Compose
from nimprep.torch.transforms.foreign import Albumentations, Torchvision
from nimprep.torch.transforms.geometry import IMAGES, Sample, crop, flip, resize
from nimprep.torch.transforms.randomly import (
    RandomCrop,
    RandomHorizontalFlip,
    RandomScale,
    Resize,
)

__all__ = [
    "IMAGES",
    "Albumentations",
    "ColorJitter",
    "Compose",
    "RandomCrop",
    "RandomHorizontalFlip",
    "RandomScale",
    "Resize",
    "Sample",
    "Torchvision",
    "crop",
    "flip",
    "jitter",
    "resize",
]
