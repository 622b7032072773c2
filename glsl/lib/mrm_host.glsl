// What MaterialX's own GLSL brings: ClosureData here, the microfacet and environment functions with every shader.
// The only file that depends on the `libraries` folder beside it; `mrm-nodes install` writes the one that fits.
#include "libraries/pbrlib/genglsl/lib/mx_closure_type.glsl"

// Which Fresnel reflectance tints the energy compensation of MaterialX's own nodes:
// 0 that of the half vector (up to 1.39.5), 1 the average over the hemisphere (from 1.39.6).
#define MRM_COMPENSATION_BY_AVERAGE_FRESNEL 0
