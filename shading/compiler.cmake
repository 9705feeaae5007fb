fr_library(fr_slc
  SOURCES ir.cpp diagnostics.cpp preprocess.cpp lexer.cpp parser.cpp parser_class.cpp parser_statement.cpp
  parser_expression.cpp
          builtins.cpp builder.cpp lower_scope.cpp lower_type.cpp lower_expression.cpp lower_call.cpp
          lower_inline.cpp lower_statement.cpp prelude.cpp uniformity.cpp analyze.cpp validate.cpp
          optimize_fold.cpp optimize_copies.cpp optimize_dead.cpp optimize_registers.cpp compile.cpp slx.cpp
          shader_library.cpp
          shadeop_library.cpp lower_shadeop.cpp
  DEPS fr_base
  PRIVATE_DEPS fmt::fmt Boost::wave ${CMAKE_DL_LIBS})
fr_test(compiler_test SOURCES compiler_test.cpp slx_test.cpp DEPS fr_slc)
