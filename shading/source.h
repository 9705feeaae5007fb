// The preprocessed text of a shader file, and where each piece of it comes from.
#pragma once

#include <string>
#include <vector>

#include "shading/diagnostics.h"

namespace fr {

struct SourceFile {
  std::string name;
  std::string text;
  uint64_t hash = 0;           // xxHash of the bytes on disk; 0: not a file
  std::string includedFrom{};  // "included from b.h, from a.sl"; "" for the first file
};

/// A run of the preprocessed text that starts at `offset` and comes from `place`, column by column.
struct SourceRun {
  uint32_t offset;
  SourcePlace place;
};

struct PreprocessedSource {
  std::string text;
  std::vector<SourceRun> runs;    // ascending offsets
  std::vector<SourceFile> files;  // files[0] is the file that was given
  SourcePlace placeOf(size_t offset) const;
  SourceLocation location(const SourcePlace& place) const;
  std::string line(const SourcePlace& place) const;  // "" when unknown
};

struct PreprocessOptions {
  std::vector<std::string> includePaths;
  std::vector<std::string> defines;  // NAME or NAME=VALUE; "!NAME" undefines a predefined macro
  size_t maxIncludeDepth = 64;
  size_t maxOutputBytes = 64u << 20;
  size_t maxMacroExpansions = 1u << 20;
};

/// Runs the C preprocessor (Boost.Wave, C99 rules) over `text`. FRANKENRENDER and BMRT are predefined as 1;
/// #line is honoured; #pragma lines stay in the text. Errors go to `diagnostics`; false when there is no
/// usable text. Never throws. Thread-safe.
bool preprocess(const std::string& fileName, std::string text, const PreprocessOptions& options,
                PreprocessedSource& out, Diagnostics& diagnostics);

/// The bytes of a regular file of at most 16 MB; every other file is an error. Line ends are left alone.
Result<std::string> readSourceFile(const std::string& path);
uint64_t hashBytes(const void* data, size_t size);

}  // namespace fr
