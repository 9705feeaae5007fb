// Conditions of IfBegin and ElseIf.
#pragma once

#include <functional>
#include <string_view>

#include "base/error.h"
#include "ri/param_list.h"

namespace fr::ri {

/// Value of a variable ("user:x"), nullptr when it is not set.
using VariableLookup = std::function<const Param*(std::string_view)>;

/// Evaluates a condition: numbers, 'strings', $name or ${name}, defined(name), ! && || == != < <= > >= =~ + -
/// * / and parentheses. Both sides are compared as numbers when both are numbers, as text otherwise; a
/// variable that is not set is empty text. kSyntax with the place in the text.
Result<bool> evaluateCondition(std::string_view text, const VariableLookup& lookup);

}  // namespace fr::ri
