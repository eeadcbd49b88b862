/* Functions that the example needs from a board. */
#ifndef BOARD_H
#define BOARD_H

/* Writes text to the debugger's, or the emulator's, standard output. */
void board_print(const char *text);

#endif
