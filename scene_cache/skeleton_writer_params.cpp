// Parameters of the RI as ParamRecords.
#include "ri/param_list.h"
#include "scene_cache/skeleton_writer.h"

namespace fr::cache {
namespace {

ParamClass classOf(ri::StorageClass c) {
  switch (c) {
    case ri::StorageClass::kConstant:
      return ParamClass::kConstant;
    case ri::StorageClass::kUniform:
      return ParamClass::kUniform;
    case ri::StorageClass::kVarying:
      return ParamClass::kVarying;
    case ri::StorageClass::kVertex:
      return ParamClass::kVertex;
    case ri::StorageClass::kFaceVertex:
      return ParamClass::kFaceVertex;
    case ri::StorageClass::kFaceVarying:
      return ParamClass::kFaceVarying;
  }
  return ParamClass::kUniform;
}

ParamType typeOf(ri::ValueType t) {
  switch (t) {
    case ri::ValueType::kFloat:
      return ParamType::kFloat;
    case ri::ValueType::kInteger:
      return ParamType::kInteger;
    case ri::ValueType::kString:
      return ParamType::kString;
    case ri::ValueType::kColor:
      return ParamType::kColor;
    case ri::ValueType::kPoint:
      return ParamType::kPoint;
    case ri::ValueType::kVector:
      return ParamType::kVector;
    case ri::ValueType::kNormal:
      return ParamType::kNormal;
    case ri::ValueType::kHpoint:
      return ParamType::kHPoint;
    case ri::ValueType::kMatrix:
      return ParamType::kMatrix;
  }
  return ParamType::kFloat;
}

}  // namespace

ParamRecord SkeletonWriter::makeFloatParam(std::string_view name, ParamClass storage, ParamType type,
                                           uint32_t arrayLength, std::span<const float> values) {
  return {intern(name), storage, type, 0, arrayLength, 0, addArray(values)};
}
ParamRecord SkeletonWriter::makeIntegerParam(std::string_view name, ParamClass storage, uint32_t arrayLength,
                                             std::span<const int32_t> values) {
  return {intern(name), storage, ParamType::kInteger, 0, arrayLength, 0, addArray(values)};
}
ParamRecord SkeletonWriter::makeStringParam(std::string_view name, ParamClass storage, uint32_t arrayLength,
                                            std::span<const StringId> values) {
  return {intern(name), storage, ParamType::kString, 0, arrayLength, 0, addArray(values)};
}

ParamRecord SkeletonWriter::makeParam(const ri::Param& p, std::string_view rename) {
  const std::string_view name = rename.empty() ? std::string_view(p.name) : rename;
  const ParamClass storage = classOf(p.declaration.storage);
  const uint32_t length = uint32_t(p.declaration.arrayLength > 0 ? p.declaration.arrayLength : 1);
  switch (p.declaration.type) {
    case ri::ValueType::kInteger:
      return makeIntegerParam(name, storage, length, p.ints);
    case ri::ValueType::kString: {
      std::vector<StringId> ids;
      ids.reserve(p.strings.size());
      for (const std::string& s : p.strings) ids.push_back(intern(s));
      return makeStringParam(name, storage, length, ids);
    }
    default:
      return makeFloatParam(name, storage, typeOf(p.declaration.type), length, p.floats);
  }
}

Slice SkeletonWriter::addParams(const ri::ParamList& list) {
  std::vector<ParamRecord> records;
  records.reserve(list.size());
  for (const ri::Param& p : list) records.push_back(makeParam(p));
  return addParams(records);
}

}  // namespace fr::cache
