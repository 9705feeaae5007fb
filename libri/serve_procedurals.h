// The program behind Procedural "DynamicLoad".
#pragma once

extern "C" {
/// Loads the shared object argv[1] and answers questions: RIB that brings about a graphics state and ends
/// with a Procedural request comes in on standard input; what the object's functions call goes out on
/// standard output as RIB up to byte 0377 (scene_cache/procedural_request.h, procedural_programs.h). Returns
/// the exit status when the input ends. What the object prints goes to standard error. A process of its own,
/// because a foreign object may crash, hang, or write where it should not.
int RiServeProcedurals(int argc, char** argv);
}
