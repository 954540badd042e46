#pragma once

#include <atomic>
#include <functional>
#include <memory>

#include "integrator/context.h"
#include "render/film.h"
#include "sampling/filter.h"
#include "wide/dispatch.h"

namespace raykiln {

struct RenderOptions {
    int width = 512, height = 512;                               ///< of the whole image
    int crop_x0 = 0, crop_y0 = 0, crop_x1 = 512, crop_y1 = 512;  ///< the part to render
    std::uint32_t spp = 64;
    std::uint32_t seed = 0;
    int threads = 0;  ///< 0 = all
    FilterKind filter = FilterKind::gaussian;
    FilmLayers layers;
    EstimatorSettings estimator;
    /// Path by path, as the textbook has it, instead of in batches: slower, and the same
    /// picture to rounding.
    bool reference = false;
    /// Whether a scene of few triangles is traced without its hierarchies.
    bool few_triangles = true;
    /// Whether light that smooth surfaces focus is looked for with a guide.
    bool caustic_guide = true;
    Isa isa = process_isa();  ///< of the batches
};

/// Renders a scene pass by pass. The film's pixels are whole at any time between calls of
/// `run`: each has the samples that its count says.
class Renderer {
  public:
    /// The scene and its hierarchy must outlive the renderer.
    Renderer(const Scene& scene, const Accel& accel, const Camera& camera,
             const RenderOptions& options);
    ~Renderer();

    /// Called about every 20 ms from the thread that called `run`, with the samples done
    /// so far; returning false stops the run within the time of one pixel.
    using Poll = std::function<bool(std::uint64_t samples_done)>;

    /// Goes on until the pass under way is finished. Returns false if `poll` stopped it.
    bool run_pass(const Poll& poll);

    /// Every pixel has this many samples at least.
    std::uint32_t samples_done() const { return samples_done_; }
    bool finished() const { return samples_done_ >= options_.spp; }
    Film& film() { return film_; }
    /// Continues from the counts in the film, after its planes were filled from a
    /// checkpoint.
    void resume();
    const RayCounts& counts() const { return counts_; }
    int threads() const { return threads_; }

  private:
    struct Tile {
        int x0, y0, x1, y1;
    };
    /// What a thread keeps from tile to tile.
    struct Worker {
        RayCounts counts;
        std::unique_ptr<BatchTracer> tracer;
        std::unique_ptr<Batch> batch;
    };
    void prepare_guide();
    void render_tile(const Tile& tile, std::uint32_t end, Worker& worker);
    void render_tile_in_batches(const Tile& tile, std::uint32_t end, Worker& worker);
    void run_batch(Worker& worker);
    void render_pixel(int x, int y, std::uint32_t end, RayCounts& counts);
    Vec3f render_sample(int x, int y, std::uint32_t index, RayCounts& counts,
                        FirstHit& first);

    const Scene& scene_;
    const Accel& accel_;
    Camera camera_;
    RenderOptions options_;
    Filter filter_;
    Film film_;
    std::unique_ptr<BatchScene> batch_scene_;  ///< null: path by path
    CausticGuide guide_;
    bool guide_prepared_ = false;
    std::vector<Tile> tiles_;
    RayCounts counts_;
    std::uint32_t samples_done_ = 0;
    int threads_ = 1;
    std::atomic<bool> stop_{false};
    std::atomic<std::uint64_t> pixel_samples_{0};
};

}  // namespace raykiln
