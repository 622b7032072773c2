// What MaterialX's own GLSL brings: ClosureData here, the microfacet and environment functions with every shader.
// The only file that depends on where the node library lies; `mrm-nodes install` writes the path that fits.
#include "libraries/pbrlib/genglsl/lib/mx_closure_type.glsl"
