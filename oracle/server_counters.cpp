#include "oracle/server_counters.h"

#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cstring>
#include <new>

namespace fr {
namespace {

constexpr uint64_t kCountersMagic = 0x31544e4352525246ull;  // "FRRRCNT1"
constexpr uint32_t kCountersVersion = 1;
constexpr uint64_t kRowsOffset = 4096;

struct CountersPage {
  std::atomic<uint64_t> magic;  // written last
  uint32_t version;
  uint32_t rows;
  uint64_t fingerprint;
  int32_t processId;
  uint32_t reserved;
  uint8_t pad[shm::kCacheLine - 32];
  std::atomic<uint64_t> gauges[32];
};
static_assert(sizeof(CountersPage) <= kRowsOffset && kGaugeCount <= 32);

constexpr uint64_t kBytes = kRowsOffset + uint64_t(ServerCounters::kMostRows) * sizeof(CounterRow);

/// What is allocated: the last bytes of a segment are its padding.
constexpr uint64_t kAllocated = shm::roundUp(kBytes + shm::kEndPadding, 4096);

uint64_t fingerprint() {
  return shm::layoutHash(kCountersVersion, sizeof(CountersPage), sizeof(CounterRow), uint64_t(kCounterCount),
                         uint64_t(kGaugeCount), ServerCounters::kMostRows);
}

shm::SegmentOptions options() {
  shm::SegmentOptions o;
  o.name = "frankenrender ray server counters";
  o.reserve = kAllocated;
  o.sealedOnly = true;
  return o;
}

CountersPage& page(const shm::Segment& s) { return *reinterpret_cast<CountersPage*>(s.data()); }
CounterRow& rowAt(const shm::Segment& s, uint32_t i) {
  return reinterpret_cast<CounterRow*>(s.data() + kRowsOffset)[i];
}

RayServerNumbers readAll(const shm::Segment& s) {
  RayServerNumbers n;
  for (uint32_t r = 0; r < ServerCounters::kMostRows; ++r)
    for (uint32_t c = 0; c < kCounterCount; ++c) n.counter[c] += rowAt(s, r).read(Counter(c));
  for (uint32_t g = 0; g < kGaugeCount; ++g) n.gauge[g] = page(s).gauges[g].load(std::memory_order_relaxed);
  n.processId = page(s).processId;
  return n;
}

}  // namespace

Result<std::unique_ptr<ServerCounters>> ServerCounters::create() {
  auto fd = shm::createSealedMemory(options().name, kAllocated);
  if (!fd) return std::move(fd).error();
  auto memory = shm::Segment::attach(std::move(fd).value(), shm::Access::kReadWrite, options());
  if (!memory) return std::move(memory).error();
  std::unique_ptr<ServerCounters> c(new ServerCounters);
  c->memory_ = std::move(memory).value();
  CountersPage& p = page(c->memory_);  // zero filled
  p.version = kCountersVersion;
  p.rows = kMostRows;
  p.fingerprint = fingerprint();
  p.processId = int32_t(::getpid());
  timespec now{};
  ::clock_gettime(CLOCK_BOOTTIME, &now);
  c->set(Gauge::kStarted, uint64_t(now.tv_sec) * 1000000000u + uint64_t(now.tv_nsec));
  // SYNC POINT: release; pairs with the acquire load in CounterReader::attach.
  p.magic.store(kCountersMagic, std::memory_order_release);
  return c;
}

CounterRow& ServerCounters::row() {
  return rowAt(memory_, std::min(used_.fetch_add(1, std::memory_order_relaxed), kMostRows - 1));
}

void ServerCounters::set(Gauge g, uint64_t value) {
  page(memory_).gauges[size_t(g)].store(value, std::memory_order_relaxed);
}

RayServerNumbers ServerCounters::read() const { return readAll(memory_); }

Result<shm::FileDescriptor> ServerCounters::share() const { return memory_.share(shm::Access::kReadOnly); }

Result<CounterReader> CounterReader::attach(shm::FileDescriptor fd) {
  auto memory = shm::Segment::attach(std::move(fd), shm::Access::kReadOnly, options());
  if (!memory) return std::move(memory).error();
  if (memory->size() < kBytes) return makeError(RiError::kBadFile, "the ray server's counters are cut off");
  const CountersPage& p = page(*memory);
  if (p.magic.load(std::memory_order_acquire) != kCountersMagic)
    return makeError(RiError::kBadFile, "what was sent are no counters of a ray server");
  if (p.version != kCountersVersion || p.fingerprint != fingerprint())
    return makeError(RiError::kVersion,
                     "the ray server's counters are of another build: version {}, this is {}", p.version,
                     kCountersVersion);
  return CounterReader(std::move(memory).value());
}

RayServerNumbers CounterReader::read() const { return readAll(memory_); }

}  // namespace fr
