#include "wide/path_tracer.h"

#include <algorithm>

#include "camera/camera.h"
#include "memory/pages.h"
#include "wide/shade.h"
#include "wide/trace.h"

// Path tracing in batches (the estimator of integrator/path.cpp, a vertex of all paths
// at a time): trace the rays, sort what they met by material, shade, trace the shadow
// rays, keep the paths that go on.

namespace raykiln {
inline namespace RAYKILN_WIDE_NAMESPACE {

namespace {

class PathTracer final : public BatchTracer {
  public:
    explicit PathTracer(const BatchScene& scene) :
        b_(scene),
        ends_(scene.scene.materials.size() + 3),
        has_environment_(!scene.scene.light_table.environments.empty()) {}

    static void* operator new(std::size_t bytes) { return allocate_pages(bytes); }
    static void operator delete(void* memory) { free_pages(memory); }

    void run(Batch& batch, RayCounts& counts) override {
        start(batch);
        counts.camera += static_cast<std::uint64_t>(size_);
        for (int depth = 1; size_ > 0; ++depth) {
            trace_paths(b_, paths_, active_, size_, depth, counts);
            sort_by_material();
            shade_all(batch, depth, counts);
            trace_shadows(b_, paths_, shadows_, depth, counts);
            if (depth >= b_.estimator.max_depth) {
                break;
            }
            keep_alive();
        }
        for (int i = 0; i < batch.size(); i += lanes) {
            const Vec3<F> sum = paths_.radiance.load_at(i);
            store(batch.radiance[0] + i, sum.x);
            store(batch.radiance[1] + i, sum.y);
            store(batch.radiance[2] + i, sum.z);
        }
    }

  private:
    /// Camera rays for all samples.
    void start(Batch& batch) {
        size_ = batch.size();
        shadows_.size = 0;
        for (int p = 0, slot = 0; p < batch.pixels; ++p) {
            const auto key = sample_key(b_.seed, batch.x[p], batch.y[p], 0).pixel;
            const int begin = slot;
            for (int i = 0; i < batch.samples; ++i, ++slot) {
                pixel_x_.at[slot] = static_cast<float>(batch.x[p]);
                pixel_y_.at[slot] = static_cast<float>(batch.y[p]);
                paths_.pixel_key.at[slot] = key;
                paths_.sample_index.at[slot] =
                    batch.first_index + static_cast<std::uint32_t>(i);
                paths_.home.at[slot] =
                    static_cast<std::uint32_t>(begin + i / lanes * lanes);
            }
        }
        const Vec3<F> zero(F(0.0f)), one(F(1.0f));
        for (int i = 0; i < size_; i += lanes) {
            const SampleKey<F> key{load(paths_.pixel_key.at + i),
                                   load(paths_.sample_index.at + i)};
            const Sample4<F> u =
                sample_4d<F, first_two>(b_.estimator.sampler, key, camera_group);
            const F x = load(pixel_x_.at + i) + F(0.5f) + b_.filter.offset(u[0]);
            const F y = load(pixel_y_.at + i) + F(0.5f) + b_.filter.offset(u[1]);
            const CameraRay<F> ray =
                camera_ray_toward(b_.camera, x / F(static_cast<float>(b_.width)),
                                  y / F(static_cast<float>(b_.height)));
            paths_.origin.store_at(i, in_lanes(b_.camera.origin));
            paths_.direction.store_at(i, ray.direction);
            store(paths_.t_near.at + i, ray.t_near);
            store(paths_.t_far.at + i, ray.t_far);
            paths_.throughput.store_at(i, one);
            paths_.radiance.store_at(i, zero);
            store(paths_.eta_scale.at + i, F(1.0f));
            store(paths_.pdf_bsdf.at + i, F(0.0f));
            store(active_.at + i, U(static_cast<std::uint32_t>(i)) + iota<U>());
            store(batch.hit + i, U(0u));
        }
    }

    /// Groups the active slots: misses first, then a material after the other; within a
    /// group they ascend.
    void sort_by_material() {
        const ShapeList& list = b_.shapes;
        for (int i = 0; i < size_; i += lanes) {
            const M valid = M::first(std::min(lanes, size_ - i));
            const U slots = select(valid, load(active_.at + i), U(active_.at[i]));
            const U geometry = paths_.geometry[slots];
            const M met = geometry != U(no_index);
            U shape = select(met, geometry, U(0u));
            if (!list.first_of_instance.empty()) {
                const U instance = paths_.instance[slots];
                const M placed = met & (instance != U(no_index));
                shape = shape +
                        gather(placed, list.first_of_instance.data(), instance, U(0u));
            }
            const U material = gather(met, list.material_of_shape.data(), shape, U(0u));
            store(group_.at + i, select(met, material + U(1u), U(0u)));
            scatter(valid, paths_.shape.at, slots, shape);
        }
        std::fill(ends_.begin(), ends_.end(), 0);
        for_each_group([&](std::uint32_t group, int, M members) {
            ends_[group + 1] += static_cast<std::uint32_t>(count(members));
        });
        // ends_[g] holds the number in group g - 1: make it where group g begins, then
        // move it to where it ends.
        for (std::size_t g = 1; g < ends_.size(); ++g) {
            ends_[g] += ends_[g - 1];
        }
        for_each_group([&](std::uint32_t group, int i, M members) {
            std::uint32_t* to = sorted_.at + ends_[group];
            const int number = count(members);
            // Other groups may already be behind these slots.
            store(M::first(number), to, compress(members, load(active_.at + i)));
            ends_[group] += static_cast<std::uint32_t>(number);
        });
    }

    /// Calls `take(group, i, members)` for each group among the lanes from `i` on, for
    /// all active slots.
    template <class Take>
    void for_each_group(const Take& take) const {
        for (int i = 0; i < size_; i += lanes) {
            const U groups = load(group_.at + i);
            M left = M::first(std::min(lanes, size_ - i));
            while (any(left)) {
                const std::uint32_t group = group_.at[i + std::countr_zero(bits(left))];
                const M members = left & (groups == U(group));
                take(group, i, members);
                left = left & !members;
            }
        }
    }

    void shade_all(Batch& batch, int depth, RayCounts& counts) {
        const std::uint32_t misses = ends_[0];
        const bool emission_alone =
            depth >= b_.estimator.max_depth && !(depth == 1 && b_.first_hits);
        for (std::uint32_t i = 0; i < misses; i += lanes) {
            const M valid =
                M::first(static_cast<int>(std::min<std::uint32_t>(lanes, misses - i)));
            const U slots = select(valid, load(sorted_.at + i), U(sorted_.at[i]));
            if (has_environment_) {
                const Vec3<F> radiance = escaped_radiance(b_, paths_, slots);
                paths_.radiance.add(valid, slots, paths_.throughput[slots] * radiance);
            }
            scatter(valid, paths_.alive.at, slots, U(0u));
        }
        std::uint32_t begin = misses;
        for (std::size_t m = 0; m < b_.scene.materials.size(); ++m) {
            const std::uint32_t end = ends_[m + 1];
            // At the end of the longest paths only emission counts.
            if (begin == end || (emission_alone && !b_.shapes.emissive_material[m])) {
                begin = end;
                continue;
            }
            const Material& material = b_.scene.materials[m];
            std::visit(
                [&](const auto& kind) {
                    for (std::uint32_t i = begin; i < end; i += lanes) {
                        const M valid = M::first(
                            static_cast<int>(std::min<std::uint32_t>(lanes, end - i)));
                        const U slots =
                            select(valid, load(sorted_.at + i), U(sorted_.at[i]));
                        shade({b_, paths_, shadows_, batch, met_, depth, slots, valid,
                               counts},
                              material, kind);
                    }
                },
                material.kind);
            begin = end;
        }
    }

    void keep_alive() {
        int kept = 0;
        for (int i = 0; i < size_; i += lanes) {
            const M valid = M::first(std::min(lanes, size_ - i));
            const U slots = select(valid, load(active_.at + i), U(0u));
            const M alive = valid & (paths_.alive[slots] != U(0u));
            kept += compress_store(alive, slots, active_.at + kept);
        }
        size_ = kept;
    }

    const BatchScene& b_;
    Paths paths_;
    ShadowRays shadows_;
    MetShapes met_;
    Plane pixel_x_, pixel_y_;
    Indices active_, sorted_, group_;
    int size_ = 0;  // number of active slots
    std::vector<std::uint32_t> ends_;
    bool has_environment_;
};

}  // namespace

BatchTracer* make_path_tracer(const BatchScene& scene) {
    return new PathTracer(scene);
}

}  // namespace RAYKILN_WIDE_NAMESPACE
}  // namespace raykiln
