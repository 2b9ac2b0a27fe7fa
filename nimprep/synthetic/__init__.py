"""Ray-cast small outdoor scenes with exact depth, normals and labels, in GMRP's raw layout.

`write_synthetic` makes a folder that the tool can be tried on with no download; `render_frame`
gives one frame as arrays, the truth beside what the sensors see. `random_street`, the surfaces of
`ground` and `solids` and `render_scene` build other scenes.
"""

from nimprep.synthetic.render import SyntheticFrame, render_frame, render_scene
from nimprep.synthetic.scene import Scene
from nimprep.synthetic.street import random_street
from nimprep.synthetic.writer import write_synthetic

__all__ = [
    "Scene",
    "SyntheticFrame",
    "random_street",
    "render_frame",
    "render_scene",
    "write_synthetic",
]
