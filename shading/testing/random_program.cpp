#include "shading/testing/random_program.h"

#include <fmt/format.h>

#include <algorithm>
#include <random>
#include <vector>

namespace fr {
namespace {

class Writer {
 public:
  explicit Writer(uint64_t seed) : random_(seed) {}

  std::string litShader() {
    lit_ = true;
    return shader();
  }

  std::string light() {
    out_ += fmt::format(
        "light random_light(float bright = {:.2f}; color tint = color (1, .75, .5); point from = point ({}, "
        "{}, -1);",
        double(1 + pick(8)) / 4, pick(3) - 1, pick(3));
    const bool nondiffuse = pick(2), spill = pick(2);
    if (nondiffuse) out_ += fmt::format(" output uniform float __nondiffuse = {:.2f};", double(pick(6)) / 4);
    if (spill) out_ += " output varying color __spill = color (.1, .2, .3);";
    out_ += ") {\n";
    open();
    add("bright", 1, true);
    for (const char* n : {"tint", "Ps", "from"}) add(n, 3, true);
    if (pick(3) == 0) add("N", 3, true);
    if (pick(4) == 0) {
      line("float dice = random();");
      add("dice", 1, false);
    }
    for (int i = pick(3); i > 0; --i) statement(pick(3));
    const int kind = pick(5);
    if (kind == 0) {
      line("Cl = " + triple(2) + ";");
    } else {
      const std::string axis = pick(2) ? "vector (.2, .1, 1)" : fmt::format("vector ({})", triple(1));
      const std::string angle = pick(2) ? "0.6" : number(1);
      line(kind == 1   ? "illuminate (from) {"
           : kind == 2 ? fmt::format("illuminate (from, {}, {}) {{", axis, angle)
           : kind == 3 ? fmt::format("solar ({}, 0) {{", axis)
                       : fmt::format("illuminate (point ({})) {{", triple(1)));
      open();
      add("L", 3, true);
      for (int i = pick(3); i > 0; --i) statement(pick(3));
      line(fmt::format("Cl = {} * bright;", triple(2)));
      if (pick(4) == 0) line("Cl *= visibility(Ps, from);");
      if (spill) line("__spill = " + triple(1) + ";");
      if (pick(3) == 0) line("Ol = " + triple(1) + ";");
      close();
      line("}");
    }
    close();
    out_ += "}\n";
    return out_;
  }

  std::string shader() {
    const int functions = pick(4);
    for (int i = 0; i < functions; ++i) function();
    out_ +=
        "surface random_shader(float gain = 1.5; color tint = color(0.25, 0.5, 1);\n"
        "    output varying color aov = 0; output varying float trail = 0;) {\n";
    open();
    for (const char* n : {"u", "v", "s", "gain"}) add(n, 1, true);
    for (const char* n : {"P", "Cs", "N", "tint"}) add(n, 3, true);
    add("aov", 3, false);
    add("trail", 1, false);
    inShader_ = true;
    const int n = 4 + pick(8);
    for (int i = 0; i < n; ++i) statement(3);
    if (pick(3) == 0) nestedFunction();
    for (int i = pick(4); i > 0; --i) statement(3);
    line("aov += " + triple(2) + ";");
    line("trail += " + number(2) + ";");
    line("Ci = " + triple(3) + " + aov * trail;");
    line("Oi = color (" + number(1) + ", " + number(2) + ", trail);");
    close();
    out_ += "}\n";
    return out_;
  }

 private:
  struct Variable {
    std::string name;
    int width;
    bool readOnly;
    int length;    // of an array; 0: none
    bool uniform;  // declared
  };
  struct Function {
    std::string name;
    int result;  // 0: void
    std::vector<int> widths;
    std::vector<bool> outputs;
    size_t depth;  // scopes that it may be called in
  };

  int pick(int n) { return int(random_() % uint64_t(n)); }
  void open() { scopes_.emplace_back(); }
  void close() {
    scopes_.pop_back();
    std::erase_if(functions_, [&](const Function& f) { return f.depth > scopes_.size(); });
  }
  void add(std::string name, int width, bool readOnly, int length = 0, bool uniform = false) {
    scopes_.back().push_back({std::move(name), width, readOnly, length, uniform});
  }
  void line(const std::string& text) { out_ += std::string(2 * scopes_.size(), ' ') + text + "\n"; }
  std::string fresh(const char* stem) { return fmt::format("{}{}", stem, ++names_); }

  const Variable* any(int width, bool written, bool array, bool uniformOnly = false) {
    std::vector<const Variable*> found;
    for (const auto& s : scopes_)
      for (const Variable& v : s)
        if (v.width == width && (v.length > 0) == array && !(written && (v.readOnly || v.uniform)) &&
            (!uniformOnly || v.uniform))
          found.push_back(&v);
    return found.empty() ? nullptr : found[size_t(pick(int(found.size())))];
  }

  std::string literal() {
    static constexpr const char* kNumbers[] = {"0",   "1",     "2", "0.5",  "-1", "3.25",
                                               "0.1", "-0.75", "7", "1e-3", "100"};
    return pick(3) ? kNumbers[pick(int(std::size(kNumbers)))]
                   : fmt::format("{:.4f}", float(pick(4001) - 2000) / 500);
  }

  /// Known when the batch starts: literals, uniform variables and what follows from them.
  std::string uniformNumber(int depth) {
    const Variable* v = any(1, false, false, true);
    switch (depth <= 0 ? pick(2) : pick(4)) {
      case 0:
        return literal();
      case 1:
        return v ? v->name : literal();
      case 2:
        return fmt::format("({} {} {})", uniformNumber(depth - 1), operators(3), uniformNumber(depth - 1));
      default:
        return fmt::format("max({}, {})", uniformNumber(depth - 1), uniformNumber(depth - 1));
    }
  }

  std::string operators(int n) {
    static constexpr const char* kOperators[] = {"+", "-", "*", "/"};
    return kOperators[pick(n)];
  }

  std::string condition(int depth) {
    static constexpr const char* kCompare[] = {"<", ">", "<=", ">=", "==", "!="};
    switch (depth <= 0 ? pick(2) : pick(8)) {
      case 0:
      case 1:
      case 2:
      case 3:
        return fmt::format("{} {} {}", number(depth - 1), kCompare[pick(6)], number(depth - 1));
      case 4:
        return fmt::format("({} && {})", condition(depth - 1), condition(depth - 1));
      case 5:
        return fmt::format("({} || {})", condition(depth - 1), condition(depth - 1));
      case 6:
        return fmt::format("!({})", condition(depth - 1));
      default:
        if (const Variable* v = any(1, true, false); v && !v->readOnly && pick(2))
          return fmt::format("({} {} ({} = {}) > 0.25)", condition(depth - 1), pick(2) ? "&&" : "||", v->name,
                             number(depth - 1));
        return fmt::format("{} {} {}", triple(depth - 1), pick(2) ? "==" : "!=", triple(depth - 1));
    }
  }

  std::string index(int length) {
    switch (pick(4)) {
      case 0:
        return fmt::format("{}", pick(length));
      case 1:
        return fmt::format("mod({}, {})", number(1), length);
      case 2:
        return fmt::format("{} * (u + {})", length, number(0));  // out of bounds too
      default:
        return fmt::format("clamp({}, 0, {})", number(1), length - 1);
    }
  }

  std::string number(int depth) {
    if (depth <= 0) {
      const Variable* v = any(1, false, false);
      return v && pick(3) ? v->name : literal();
    }
    static constexpr const char* kOne[] = {"sin", "cos",  "sqrt",  "exp",  "log",
                                           "abs", "sign", "floor", "ceil", "round"};
    static constexpr const char* kTwo[] = {"pow", "mod", "min", "max", "step"};
    switch (pick(20)) {
      case 0:
      case 1:
      case 2:
      case 3:
      case 4:
        return fmt::format("({} {} {})", number(depth - 1), operators(4), number(depth - 1));
      case 5:
        return fmt::format("{}({})", kOne[pick(10)], number(depth - 1));
      case 6:
        return fmt::format("{}({}, {})", kTwo[pick(5)], number(depth - 1), number(depth - 1));
      case 7:
        return fmt::format("{}({}, {}, {})", pick(2) ? "clamp" : "mix", number(depth - 1), number(depth - 1),
                           number(depth - 1));
      case 8:
        return fmt::format("smoothstep({}, {}, {})", number(depth - 1), number(depth - 1), number(depth - 1));
      case 9:
        return fmt::format("({} ? {} : {})", condition(depth - 1), number(depth - 1), number(depth - 1));
      case 10:
        return fmt::format("({} . {})", triple(depth - 1), triple(depth - 1));
      case 11:
        return fmt::format("{}comp({})", "xyz"[pick(3)], triple(depth - 1));
      case 12:
        return fmt::format("comp({}, {})", triple(depth - 1),
                           pick(2) ? fmt::format("{}", pick(3)) : number(depth - 1));
      case 13:
        return fmt::format("float {}({})", pick(2) ? "noise" : "cellnoise",
                           pick(2) ? number(depth - 1) : point(depth - 1));
      case 14:
        return fmt::format("length({})", point(depth - 1));
      case 15:
        if (const Variable* v = any(1, false, true)) return fmt::format("{}[{}]", v->name, index(v->length));
        return fmt::format("-({})", number(depth - 1));
      case 16:
        if (const std::string c = call(1, depth); !c.empty()) return c;
        return fmt::format("distance({}, {})", point(depth - 1), point(depth - 1));
      case 17:
        return fmt::format("({})", condition(depth - 1));
      case 18:
        if (const Variable* v = any(3, false, false)) return fmt::format("{}[{}]", v->name, index(3));
        return literal();
      default: {
        const Variable* v = any(1, false, false);
        return v ? v->name : literal();
      }
    }
  }

  std::string point(int depth) { return fmt::format("point ({})", triple(depth)); }

  std::string triple(int depth) {
    if (depth <= 0) {
      const Variable* v = any(3, false, false);
      return v && pick(3) ? fmt::format("color {}", v->name)
                          : fmt::format("color ({}, {}, {})", literal(), number(0), literal());
    }
    switch (pick(14)) {
      case 0:
      case 1:
      case 2:
        return fmt::format("({} {} {})", triple(depth - 1), operators(4), triple(depth - 1));
      case 3:
        return fmt::format("({} {} {})", triple(depth - 1), operators(4), number(depth - 1));
      case 4:
        return fmt::format("({} {} {})", number(depth - 1), operators(3), triple(depth - 1));
      case 5:
        return fmt::format("color ({}, {}, {})", number(depth - 1), number(depth - 1), number(depth - 1));
      case 6:
        return fmt::format("mix({}, {}, {})", triple(depth - 1), triple(depth - 1), number(depth - 1));
      case 7:
        return fmt::format("{}({}, {})", pick(2) ? "min" : "max", triple(depth - 1), triple(depth - 1));
      case 8:
        return fmt::format("({} ? {} : {})", condition(depth - 1), triple(depth - 1), triple(depth - 1));
      case 9:
        return fmt::format("color (normalize(vector {}))", triple(depth - 1));
      case 10:
        return fmt::format("color (vector {} ^ vector {})", triple(depth - 1), triple(depth - 1));
      case 11:
        if (const Variable* v = any(3, false, true))
          return fmt::format("color {}[{}]", v->name, index(v->length));
        return fmt::format("color ({})", number(depth - 1));
      case 12:
        if (const std::string c = call(3, depth); !c.empty()) return "color " + c;
        return fmt::format("clamp({}, {}, {})", triple(depth - 1), triple(depth - 1), triple(depth - 1));
      default:
        return fmt::format("-({})", triple(depth - 1));
    }
  }

  std::string value(int width, int depth) { return width == 1 ? number(depth) : triple(depth); }

  /// "" when there is no function for it. Functions with outputs are called by statements alone.
  std::string call(int result, int depth) {
    std::vector<const Function*> fit;
    for (const Function& f : functions_) {
      bool plain = f.result == result;
      for (bool o : f.outputs) plain = plain && !o;
      if (plain) fit.push_back(&f);
    }
    if (fit.empty() || ++calls_ > 12) return {};
    const Function& f = *fit[size_t(pick(int(fit.size())))];
    std::string r = f.name + "(";
    for (size_t i = 0; i < f.widths.size(); ++i) r += (i ? ", " : "") + value(f.widths[i], depth - 1);
    return r + ")";
  }

  void callStatement() {
    if (functions_.empty() || ++calls_ > 12) return;
    const Function f = functions_[size_t(pick(int(functions_.size())))];
    std::vector<std::string> taken;
    std::string r = f.name + "(";
    for (size_t i = 0; i < f.widths.size(); ++i) {
      if (!f.outputs[i]) {
        r += (i ? ", " : "") + value(f.widths[i], 2);
        continue;
      }
      const Variable* v = any(f.widths[i], true, false);
      if (!v || std::find(taken.begin(), taken.end(), v->name) != taken.end()) return;
      taken.push_back(v->name);
      r += (i ? ", " : "") + v->name;
    }
    line(r + ");");
  }

  void declaration() {
    const int width = pick(5) < 3 ? 1 : 3;
    static constexpr const char* kTriples[] = {"color", "point", "vector", "normal"};
    const std::string type = width == 1 ? "float" : kTriples[pick(4)];
    switch (pick(5)) {
      case 0: {
        const int length = 2 + pick(4);
        const std::string name = fresh("a");
        std::string values;
        for (int i = 0; i < length; ++i)
          values += (i ? ", " : "") + (width == 1 ? number(1) : type + " (" + triple(1) + ")");
        line(fmt::format("{} {}[{}] = {{{}}};", type, name, length, values));
        add(name, width, false, length);
        return;
      }
      case 1: {
        const std::string name = fresh("k");
        line(fmt::format("uniform float {} = {};", name, uniformNumber(2)));
        add(name, 1, false, 0, true);
        return;
      }
      default: {
        const std::string name = fresh("x");
        const std::string init = width == 1 ? number(3) : type + " (" + triple(2) + ")";
        line(fmt::format("{}{} {} = {};", pick(3) ? "" : "varying ", type, name, init));
        add(name, width, false);
      }
    }
  }

  void assignment() {
    static constexpr const char* kAssign[] = {"=", "+=", "-=", "*=", "/="};
    const int width = pick(2) ? 1 : 3;
    const std::string op = pick(2) ? "=" : kAssign[pick(5)];
    if (pick(4) == 0) {
      if (const Variable* v = any(width, true, true)) {
        line(fmt::format("{}[{}] {} {};", v->name, index(v->length), op, value(width, 2)));
        return;
      }
    }
    const Variable* v = any(width, true, false);
    if (!v) return;
    if (width == 3 && pick(4) == 0)
      line(fmt::format("{}[{}] {} {};", v->name, index(3), op, number(2)));
    else if (width == 3 && pick(5) == 0)
      line(fmt::format("setcomp({}, {}, {});", v->name, index(3), number(2)));
    else
      line(fmt::format("{} {} {};", v->name, op, value(width, 3)));
  }

  void block(int depth) {
    open();
    for (int i = 1 + pick(3); i > 0; --i) statement(depth - 1);
    close();
  }

  void jump() {
    if (loops_ > 0 && pick(2)) {
      const int levels = 1 + pick(loops_);
      line(fmt::format("if ({}) {}{};", condition(1), pick(2) ? "break" : "continue",
                       levels > 1 ? fmt::format(" {}", levels) : ""));
    } else if (returns_ && pick(2)) {
      line(fmt::format("if ({}) return {};", condition(1), value(returns_, 1)));
    } else if (inShader_ && !returns_ && pick(4) == 0) {
      line(fmt::format("if ({}) return;", condition(1)));
    }
  }

  void loop(int depth) {
    const std::string i = fresh("i");
    line(fmt::format("float {} = 0;", i));
    add(i, 1, true);
    const std::string end =
        pick(2) ? fmt::format("{}", 1 + pick(5)) : fmt::format("clamp({}, 0, 4)", number(1));
    // A continue must not skip what ends the loop.
    if (pick(3))
      line(fmt::format("for ({} = 0; {} < {}; {} += 1) {{", i, i, end, i));
    else
      line(fmt::format("while (({} += 1) <= {}) {{", i, end));
    ++loops_;
    block(depth);
    --loops_;
    line("}");
  }

  void lightLoop(int depth) {
    ++lightLoops_;
    switch (pick(4)) {
      case 0:
        line(fmt::format("aov += diffuse(N) + specular(N, vector ({}), 0.2);", triple(1)));
        break;
      case 1:
        line("aov += ambient();");
        break;
      default: {
        const std::string place = pick(3) ? "P" : fmt::format("point ({})", triple(1));
        const std::string axis = pick(2) ? "N" : fmt::format("vector ({})", triple(1));
        line(pick(2)
                 ? fmt::format("illuminance ({}) {{", place)
                 : fmt::format("illuminance ({}, {}, {}) {{", place, axis, pick(2) ? "PI / 2" : number(1)));
        open();
        for (const char* n : {"Cl", "L", "Ol"}) add(n, 3, true);
        if (pick(2)) {
          const std::string m = fresh("m");
          const bool triple = pick(2);
          line(fmt::format("{0} {1} = 0; lightsource(\"{2}\", {1});", triple ? "color" : "float", m,
                           triple ? "__spill" : "__nondiffuse"));
          add(m, triple ? 3 : 1, false);
        }
        ++loops_;
        block(depth);
        --loops_;
        line("aov += Cl;");
        close();
        line("}");
      }
    }
    --lightLoops_;
  }

  void statement(int depth) {
    if (out_.size() > 9000) return assignment();
    if (lit_ && inShader_ && depth > 0 && lightLoops_ < 2 && pick(5) == 0) return lightLoop(depth);
    switch (depth <= 0 ? pick(6) : pick(12)) {
      case 0:
      case 1:
        return declaration();
      case 2:
      case 3:
      case 4:
        return assignment();
      case 5:
        return pick(2) ? jump() : callStatement();
      case 6:
      case 7:
        // Conditions that are the same for all points are executed another way.
        line(pick(3) ? fmt::format("if ({}) {{", condition(2))
                     : fmt::format("if ({} < {}) {{", uniformNumber(1), uniformNumber(2)));
        block(depth);
        if (pick(2)) {
          line("} else {");
          block(depth);
        }
        line("}");
        return;
      case 8:
      case 9:
        return loopDepth_ < 3 ? (++loopDepth_, loop(depth), void(--loopDepth_)) : assignment();
      default:
        line("{");
        block(depth);
        line("}");
    }
  }

  void functionText(bool nested) {
    Function f;
    f.name = fresh("f");
    f.result = pick(5) == 0 ? 0 : pick(2) ? 1 : 3;
    f.depth = nested ? scopes_.size() : 0;
    std::string formals;
    const int n = 1 + pick(3);
    const int returns = returns_, loops = loops_;
    const bool shader = inShader_;
    std::vector<Variable> mine;
    for (int i = 0; i < n; ++i) {
      const int width = pick(2) ? 1 : 3;
      const bool output = f.result == 0 ? i == 0 || pick(2) : pick(6) == 0;
      const std::string name = fresh("q");
      formals += fmt::format("{}{}{} {}", i ? "; " : "", output ? "output " : "",
                             width == 1 ? "float" : "color", name);
      mine.push_back({name, width, !output && pick(2) == 0, 0, false});
      f.widths.push_back(width);
      f.outputs.push_back(output);
    }
    line(fmt::format("{} {}({}) {{",
                     f.result == 0   ? "void"
                     : f.result == 1 ? "float"
                                     : "color",
                     f.name, formals));
    open();
    // A nested function sees what surrounds it, and may change it.
    if (!nested)
      for (const char* g : {"u", "v"}) mine.push_back({g, 1, true, 0, false});
    scopes_.back() = mine;
    returns_ = f.result, loops_ = 0, inShader_ = false;
    for (int i = 1 + pick(4); i > 0; --i) statement(2);
    if (f.result) line(fmt::format("return {};", value(f.result, 2)));
    close();
    returns_ = returns, loops_ = loops, inShader_ = shader;
    line("}");
    functions_.push_back(f);
  }

  void function() { functionText(false); }
  void nestedFunction() { functionText(true); }

  std::mt19937_64 random_;
  std::string out_;
  std::vector<std::vector<Variable>> scopes_;
  std::vector<Function> functions_;
  int names_ = 0, loops_ = 0, loopDepth_ = 0, returns_ = 0, calls_ = 0;
  int lightLoops_ = 0;
  bool inShader_ = false, lit_ = false;
};

}  // namespace

std::string randomShader(uint64_t seed) { return Writer(seed).shader(); }
std::string randomLitShader(uint64_t seed) { return Writer(seed).litShader(); }
std::string randomLight(uint64_t seed) { return Writer(seed).light(); }

}  // namespace fr
