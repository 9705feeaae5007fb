// Sizes on the command line.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace fr::tools {

/// "512M", "1.5g", "4096", "2GiB": bytes, K, M, G, T are powers of 1024. Nothing for anything else.
std::optional<uint64_t> parseBytes(std::string_view text);

}  // namespace fr::tools
