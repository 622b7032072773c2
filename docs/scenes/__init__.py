"""The pictures of the README: geometry and textures made here, rendered with the node library."""
