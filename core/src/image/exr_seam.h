#pragma once

// Included by src/image only: nothing else may see OpenEXR.

#include <ImfIO.h>

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <span>
#include <vector>

namespace raykiln {

/// A file in memory, which is not copied.
class ExrMemoryInput final : public Imf::IStream {
  public:
    explicit ExrMemoryInput(std::span<const std::byte> file) :
        IStream("<memory>"),
        file_(file) {}

    bool isMemoryMapped() const override { return true; }
    bool read(char to[], int count) override;
    char* readMemoryMapped(int count) override;
    uint64_t tellg() override { return at_; }
    void seekg(uint64_t position) override { at_ = position; }

  private:
    std::span<const std::byte> file_;
    std::uint64_t at_ = 0;
};

/// A file on disk, read as it is decoded.
class ExrFileInput final : public Imf::IStream {
  public:
    /// Throws ImageError if it cannot be opened.
    explicit ExrFileInput(const std::filesystem::path& path);

    bool read(char to[], int count) override;
    uint64_t tellg() override { return at_; }
    void seekg(uint64_t position) override;

  private:
    std::unique_ptr<std::FILE, int (*)(std::FILE*)> file_;
    std::uint64_t at_ = 0;
};

/// A file that is written into memory.
class ExrMemoryOutput final : public Imf::OStream {
  public:
    ExrMemoryOutput() : OStream("<memory>") {}

    void write(const char from[], int count) override;
    uint64_t tellp() override { return at_; }
    void seekp(uint64_t position) override { at_ = position; }

    std::vector<unsigned char> bytes;

  private:
    std::uint64_t at_ = 0;
};

/// OpenEXR's threads, for as long as somebody codes an image for which they pay.
///
/// They end with the last such image: a process that forks while they wait would have a
/// child that waits for them forever.
class ExrThreads {
  public:
    /// How many there are where they pay.
    static int most();
    /// `bytes`: of pixels to code.
    explicit ExrThreads(std::uint64_t bytes);
    ~ExrThreads();
    ExrThreads(const ExrThreads&) = delete;
    ExrThreads& operator=(const ExrThreads&) = delete;

    /// For the constructors of OpenEXR's files: 0 is the calling thread alone.
    int count() const { return count_; }

  private:
    int count_ = 0;
};

}  // namespace raykiln
