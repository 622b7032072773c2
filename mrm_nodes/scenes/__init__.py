"""Scenes worth looking at: cones, a vest, a road, and the paper's Figures 3 and 5.

Every retroreflector in them is an `mrm_open_pbr_surface` whose `specular_retroreflectivity` a texture drives.
Geometry and textures are computed.
"""

from mrm_nodes.scenes.gallery import TITLES, draw, scene_gallery

__all__ = ["TITLES", "draw", "scene_gallery"]
