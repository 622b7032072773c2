// What MaterialX's own GLSL brings: ClosureData here, the microfacet and environment functions with every shader.
// The only file that depends on the `libraries` folder beside it; `mrm-nodes install` writes the one that fits.
#include "libraries/pbrlib/genglsl/lib/mx_closure_type.glsl"

// Which Fresnel reflectance tints the energy compensation of MaterialX's own nodes:
// 0 that of the half vector (up to 1.39.5), 1 the average over the hemisphere (from 1.39.6).
#define MRM_COMPENSATION_BY_AVERAGE_FRESNEL 0

// A matrix times a vector: an operator up to 1.39.4, then a function, for targets that have no such operator.
#define MRM_MATRIX_MUL(m, v) mx_matrix_mul(m, v)

// The method by which the host evaluates image light. Whoever knows it when the shader is compiled may define it:
// then one loop serves both lobes, where else the host's own function is called for each.
#define MRM_ENVIRONMENT_UNKNOWN 0
#define MRM_ENVIRONMENT_FIS 1
#define MRM_ENVIRONMENT_PREFILTER 2
#ifndef MRM_ENVIRONMENT
#define MRM_ENVIRONMENT MRM_ENVIRONMENT_UNKNOWN
#endif
