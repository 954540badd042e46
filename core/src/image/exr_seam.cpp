#include "image/exr_seam.h"

#include <Iex.h>
#include <ImfThreading.h>

#include <algorithm>
#include <cstring>
#include <mutex>
#include <thread>

#include "error.h"

namespace raykiln {

char* ExrMemoryInput::readMemoryMapped(int count) {
    if (count < 0 || at_ > file_.size() ||
        static_cast<std::uint64_t>(count) > file_.size() - at_) {
        throw Iex::InputExc("Unexpected end of file.");
    }
    const std::byte* here = file_.data() + at_;
    at_ += static_cast<std::uint64_t>(count);
    // OpenEXR reads only; its interface knows no const.
    return const_cast<char*>(reinterpret_cast<const char*>(here));
}

bool ExrMemoryInput::read(char to[], int count) {
    std::memcpy(to, readMemoryMapped(count), static_cast<std::size_t>(count));
    return at_ < file_.size();
}

ExrFileInput::ExrFileInput(const std::filesystem::path& path) :
    IStream("<file>"),
    file_(std::fopen(path.c_str(), "rbe"), &std::fclose) {
    if (!file_) {
        throw ImageError("the file cannot be opened");
    }
}

bool ExrFileInput::read(char to[], int count) {
    if (count < 0 || std::fread(to, 1, static_cast<std::size_t>(count), file_.get()) !=
                         static_cast<std::size_t>(count)) {
        throw Iex::InputExc("Unexpected end of file.");
    }
    at_ += static_cast<std::uint64_t>(count);
    return std::feof(file_.get()) == 0;
}

void ExrFileInput::seekg(uint64_t position) {
    // A damaged file may ask for any place; what lies behind the end is found on reading.
    if (position > static_cast<std::uint64_t>(INT64_MAX) ||
        fseeko(file_.get(), static_cast<off_t>(position), SEEK_SET) != 0) {
        throw Iex::InputExc("A position outside of the file.");
    }
    at_ = position;
}

void ExrMemoryOutput::write(const char from[], int count) {
    const std::uint64_t end = at_ + static_cast<std::uint64_t>(count);
    if (end > bytes.size()) {
        bytes.resize(end);
    }
    std::memcpy(bytes.data() + at_, from, static_cast<std::size_t>(count));
    at_ = end;
}

namespace {

// Coding less than this is over before threads are there.
constexpr std::uint64_t worth_threads = 512 << 10;

std::mutex users_mutex;
int users = 0;

}  // namespace

int ExrThreads::most() {
    return static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1u, 8u));
}

ExrThreads::ExrThreads(std::uint64_t bytes) {
    if (bytes < worth_threads || most() < 2) {
        return;
    }
    const std::lock_guard lock(users_mutex);
    if (users == 0) {
        Imf::setGlobalThreadCount(most());
    }
    ++users;
    count_ = most();
}

ExrThreads::~ExrThreads() {
    if (count_ == 0) {
        return;
    }
    const std::lock_guard lock(users_mutex);
    if (--users == 0) {
        Imf::setGlobalThreadCount(0);
    }
}

}  // namespace raykiln
