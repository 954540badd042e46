#pragma once

namespace raykiln {

/// Share of light that a GGX surface reflects, as a sum over Schlick's two ends: `at_f0`
/// times the reflectance head-on plus `at_f90` times that at grazing angles.
struct GgxAlbedo {
    float at_f0, at_f90;

    float with_fresnel(float f0, float f90) const { return f0 * at_f0 + f90 * at_f90; }
};

/// Towards one direction, for height-correlated shadowing; from a table.
GgxAlbedo ggx_albedo(float alpha, float cosine);
/// The cosine-weighted mean over all directions.
GgxAlbedo ggx_mean_albedo(float alpha);

}  // namespace raykiln
