/* Shaders written for ray servers begin with #include "rayserver.h", which turned trace(), visibility(),
   rayhittest(), fulltrace() and the others into calls of a plug-in. Here they are part of the language: nothing is
   left to define. */
#ifndef RAYSERVER_H
#define RAYSERVER_H 1
#endif
