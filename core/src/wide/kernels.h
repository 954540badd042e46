#pragma once

#include <cstddef>
#include <cstdint>

#include "accel/few_triangles.h"
#include "guide/caustic_guide.h"
#include "integrator/context.h"
#include "sampling/filter.h"
#include "scene/camera.h"
#include "wide/shapes.h"

// The wide estimator: paths in batches, as many at once as the processor has lanes. It is
// compiled once for each instruction set; this is what the renderer sees of it.

namespace raykiln {

/// What all batches of a render read.
struct BatchScene {
    const Scene& scene;
    const Accel& accel;
    const Camera& camera;
    const Filter& filter;
    EstimatorSettings estimator;
    int width, height;  ///< of the whole image
    std::uint32_t seed;
    bool first_hits;  ///< whether those are asked for
    ShapeList shapes;
    FewTriangles few_triangles;           ///< empty: the hierarchies of `accel` are used
    const CausticGuide* guide = nullptr;  ///< null: there is none

    /// Among many lights, shadow rays are sorted by them: of more rays more go alike.
    bool sorts_shadows() const { return scene.near_lights.size() >= 64; }
    /// Samples of a batch that is full.
    int batch_size() const;
};

/// Pixels of a batch and the sample numbers that each gets, and where the results are:
/// sample i of pixel p at p * samples + i.
struct Batch {
    static constexpr int capacity = 4096;
    /// What fits the caches beside a scene's hierarchy.
    static constexpr int usual_size = 1024;
    static constexpr int padded = capacity + 16;

    int pixels = 0;
    int samples = 0;                         ///< a pixel; pixels * samples <= capacity
    std::uint32_t first_index = 0;           ///< number of the first of them
    std::uint32_t x[capacity], y[capacity];  ///< of the whole image

    float radiance[3][padded];
    // What the first surfaces are like, if asked for; hit is 0 where there is none.
    float albedo[3][padded], normal[3][padded], depth[padded];
    std::uint32_t hit[padded];

    int size() const { return pixels * samples; }
};

inline int BatchScene::batch_size() const {
    return sorts_shadows() ? Batch::capacity : Batch::usual_size;
}

/// One thread's working memory for batches.
class BatchTracer {
  public:
    virtual ~BatchTracer() = default;
    virtual void run(Batch& batch, RayCounts& counts) = 0;
};

/// The entry points of one instruction set.
struct WideKernels {
    std::size_t width;  ///< lanes
    const char* isa;    ///< "sse4.2", "avx2" or "avx512"
    /// Four dimensions of `count` samples, as `sobol_sample` makes them one by one.
    void (*sobol_samples)(const std::uint32_t* pixel, const std::uint32_t* index,
                          std::size_t count, std::uint32_t group, float* out);
    /// The scene must outlive the tracer, which belongs to the caller.
    BatchTracer* (*make_tracer)(const BatchScene& scene);
};

}  // namespace raykiln

extern "C" {
const raykiln::WideKernels* raykiln_wide_sse42();
const raykiln::WideKernels* raykiln_wide_avx2();
const raykiln::WideKernels* raykiln_wide_avx512();
}
