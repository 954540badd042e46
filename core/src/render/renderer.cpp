#include "render/renderer.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>
#include <tbb/task_group.h>

#include <algorithm>
#include <chrono>
#include <exception>
#include <future>
#include <utility>

#include "camera/camera.h"
#include "render/learn_caustics.h"

namespace raykiln {

namespace {

constexpr int tile_size = 16;
constexpr std::chrono::milliseconds poll_interval{20};

}  // namespace

Renderer::Renderer(const Scene& scene, const Accel& accel, const Camera& camera,
                   const RenderOptions& options) :
    scene_(scene),
    accel_(accel),
    camera_(camera),
    options_(options),
    filter_(options.filter),
    film_(options.crop_x1 - options.crop_x0, options.crop_y1 - options.crop_y0,
          options.layers),
    threads_(options.threads > 0 ? options.threads : tbb::info::default_concurrency()) {
    for (int y = 0; y < film_.height(); y += tile_size) {
        for (int x = 0; x < film_.width(); x += tile_size) {
            tiles_.push_back({x, y, std::min(x + tile_size, film_.width()),
                              std::min(y + tile_size, film_.height())});
        }
    }
    EstimatorSettings& e = options_.estimator;
    if (e.integrator == IntegratorKind::direct) {
        e.integrator = IntegratorKind::path;
        e.max_depth = std::min(e.max_depth, 2);
    }
    if (e.integrator == IntegratorKind::path && !options_.reference) {
        const FilmLayers& layers = options_.layers;
        batch_scene_ = std::make_unique<BatchScene>(BatchScene{
            scene_, accel_, camera_, filter_, e, options_.width, options_.height,
            options_.seed, layers.albedo || layers.normal || layers.depth,
            ShapeList(scene_),
            options_.few_triangles ? FewTriangles(scene_) : FewTriangles(), &guide_});
    }
}

Renderer::~Renderer() = default;

void Renderer::resume() {
    const auto& counts = film_.counts();
    samples_done_ = *std::min_element(counts.begin(), counts.end());
    std::uint64_t total = 0;
    for (const std::uint32_t count : counts) {
        total += count;
    }
    pixel_samples_ = total;
}

bool Renderer::run_pass(const Poll& poll) {
    if (finished()) {
        return true;
    }
    const std::uint32_t end = next_pass(samples_done_, options_.spp);
    stop_ = false;
    tbb::enumerable_thread_specific<Worker> workers;
    // More threads than cores are allowed if they are asked for.
    const tbb::global_control limit(
        tbb::global_control::max_allowed_parallelism,
        static_cast<std::size_t>(std::max(threads_, tbb::info::default_concurrency())) +
            1);
    // One slot more than threads: the caller polls and does not render.
    tbb::task_arena arena(threads_, 0);
    std::promise<void> done;
    auto finished_pass = done.get_future();
    arena.enqueue([&] {
        try {
            prepare_guide();
            tbb::parallel_for(
                std::size_t{0}, tiles_.size(),
                [&](std::size_t i) { render_tile(tiles_[i], end, workers.local()); },
                tbb::simple_partitioner());
            done.set_value();
        } catch (...) {
            done.set_exception(std::current_exception());
        }
    });
    bool wanted = true;
    std::exception_ptr error;
    while (finished_pass.wait_for(poll_interval) != std::future_status::ready) {
        if (!wanted) {
            continue;
        }
        try {
            wanted = poll(pixel_samples_);
        } catch (...) {
            error = std::current_exception();
            wanted = false;
        }
        stop_ = !wanted;
    }
    finished_pass.get();
    for (const Worker& worker : workers) {
        counts_ += worker.counts;
    }
    if (error) {
        std::rethrow_exception(error);
    }
    if (wanted) {
        samples_done_ = end;
    }
    return wanted;
}

void Renderer::prepare_guide() {
    const EstimatorSettings& e = options_.estimator;
    if (std::exchange(guide_prepared_, true) || !options_.caustic_guide ||
        e.integrator != IntegratorKind::path) {
        return;
    }
    const auto samples = static_cast<std::uint64_t>(options_.width) *
                         static_cast<std::uint64_t>(options_.height) * options_.spp;
    guide_ = learn_caustics(scene_, accel_, e, options_.seed, samples);
}

void Renderer::render_tile(const Tile& tile, std::uint32_t end, Worker& worker) {
    if (batch_scene_) {
        render_tile_in_batches(tile, end, worker);
        return;
    }
    std::uint64_t samples = 0;
    for (int y = tile.y0; y < tile.y1 && !stop_.load(std::memory_order_relaxed); ++y) {
        for (int x = tile.x0; x < tile.x1 && !stop_.load(std::memory_order_relaxed);
             ++x) {
            samples += end - std::min(end, film_.count(x, y));
            render_pixel(x, y, end, worker.counts);
        }
    }
    pixel_samples_ += samples;
}

void Renderer::render_tile_in_batches(const Tile& tile, std::uint32_t end,
                                      Worker& worker) {
    if (!worker.tracer) {
        worker.tracer.reset(wide_kernels(options_.isa).make_tracer(*batch_scene_));
        worker.batch = std::make_unique<Batch>();
    }
    Batch& batch = *worker.batch;
    batch.pixels = 0;
    const int most = batch_scene_->batch_size();
    for (int y = tile.y0; y < tile.y1; ++y) {
        for (int x = tile.x0; x < tile.x1; ++x) {
            const std::uint32_t begin = film_.count(x, y);
            if (begin >= end) {
                continue;
            }
            const int samples = static_cast<int>(end - begin);
            if (batch.pixels > 0 &&
                (begin != batch.first_index || (batch.pixels + 1) * samples > most)) {
                run_batch(worker);
            }
            batch.first_index = begin;
            batch.samples = samples;
            batch.x[batch.pixels] = static_cast<std::uint32_t>(x + options_.crop_x0);
            batch.y[batch.pixels] = static_cast<std::uint32_t>(y + options_.crop_y0);
            ++batch.pixels;
        }
    }
    if (batch.pixels > 0) {
        run_batch(worker);
    }
}

void Renderer::run_batch(Worker& worker) {
    Batch& batch = *worker.batch;
    const int pixels = std::exchange(batch.pixels, 0);
    if (stop_.load(std::memory_order_relaxed)) {
        return;
    }
    batch.pixels = pixels;
    worker.tracer->run(batch, worker.counts);
    for (int p = 0; p < pixels; ++p) {
        PixelSums sums;
        for (int i = p * batch.samples; i < (p + 1) * batch.samples; ++i) {
            sums.add_radiance(
                {batch.radiance[0][i], batch.radiance[1][i], batch.radiance[2][i]},
                worker.counts.nonfinite);
            if (batch_scene_->first_hits && batch.hit[i] != 0) {
                sums.add_first_hit(
                    {batch.albedo[0][i], batch.albedo[1][i], batch.albedo[2][i]},
                    {batch.normal[0][i], batch.normal[1][i], batch.normal[2][i]},
                    batch.depth[i]);
            }
        }
        film_.add(static_cast<int>(batch.x[p]) - options_.crop_x0,
                  static_cast<int>(batch.y[p]) - options_.crop_y0, sums,
                  batch.first_index + static_cast<std::uint32_t>(batch.samples));
    }
    pixel_samples_ += static_cast<std::uint64_t>(batch.size());
    batch.pixels = 0;
}

void Renderer::render_pixel(int x, int y, std::uint32_t end, RayCounts& counts) {
    const std::uint32_t begin = film_.count(x, y);
    if (begin >= end) {
        return;
    }
    PixelSums sums;
    for (std::uint32_t index = begin; index < end; ++index) {
        FirstHit first;
        const Vec3f radiance = render_sample(x + options_.crop_x0, y + options_.crop_y0,
                                             index, counts, first);
        sums.add_radiance(radiance, counts.nonfinite);
        if (first.valid) {
            sums.add_first_hit(first.albedo, first.normal, first.depth);
        }
    }
    film_.add(x, y, sums, end);
}

Vec3f Renderer::render_sample(int x, int y, std::uint32_t index, RayCounts& counts,
                              FirstHit& first) {
    const SampleKey<float> key = sample_key(options_.seed, static_cast<std::uint32_t>(x),
                                            static_cast<std::uint32_t>(y), index);
    const Context c{scene_, accel_, options_.estimator, key, counts, &guide_};
    const Sample4<float> u = c.draw(camera_group);
    const float px = static_cast<float>(x) + 0.5f + filter_.offset(u[0]);
    const float py = static_cast<float>(y) + 0.5f + filter_.offset(u[1]);
    const Ray ray = camera_ray(camera_, px / static_cast<float>(options_.width),
                               py / static_cast<float>(options_.height));
    ++counts.camera;
    Vec3f radiance;
    switch (options_.estimator.integrator) {
        case IntegratorKind::direct:  // a path of two segments, see the constructor
        case IntegratorKind::path:
            radiance = estimate_path(c, ray, first);
            break;
        case IntegratorKind::whitted:
            radiance = estimate_whitted(c, ray, first);
            break;
        case IntegratorKind::ao:
            radiance = estimate_ao(c, ray, first);
            break;
    }
    if (first.valid) {
        first.depth = view_depth(camera_, first.point);
    }
    return radiance;
}

}  // namespace raykiln
