// Runs the shared object of Procedural "DynamicLoad" (started by the renderers, not by users).
#include "libri/serve_procedurals.h"

int main(int argc, char** argv) { return RiServeProcedurals(argc, argv); }
