// SPDX-License-Identifier: GPL-3.0-or-later
// Runs kernels of another processor or system for the tests: an emulator starts it, remote.py talks to it.
//
// Each request on stdin names a kernel, brings the memory it works on and its arguments; the answer on stdout is the
// kernel's result and the memory as it left it. Built with -DTABLE="file" the kernels are linked in, listed in that
// file; else argv[1] is the shared library to load, the one that is shipped.
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <fcntl.h>
#include <io.h>
#include <malloc.h>
#include <windows.h>
#elif !defined(TABLE)
#include <dlfcn.h>
#endif

enum { MOST_BUFFERS = 256, MOST_ARGUMENTS = 40, MOST_FLOATS = 8, WINDOWS_REGISTERS = 4 };

typedef void (*Kernel)(void);
typedef struct {
    uint64_t key, size;  // key: where Python has it
    char *at;
} Buffer;
typedef struct {
    uint64_t *at, before, during;
} Moved;

static Buffer buffers[MOST_BUFFERS];
static int64_t number;

static void give_up(const char *why) {
    fprintf(stderr, "host: %s\n", why);
    exit(9);
}

static void take(void *to, size_t size) {
    if (size && fread(to, 1, size, stdin) != size) exit(0);  // Python is gone
}

static uint64_t word(void) {
    uint64_t value;
    take(&value, 8);
    return value;
}

static char *space(uint64_t size) {
#ifdef _WIN32
    char *at = _aligned_malloc(size + 64, 64);
#else
    char *at = aligned_alloc(64, (size + 127) / 64 * 64);
#endif
    if (!at) give_up("out of memory");
    return at;
}

static void forget_all(void) {
    for (int64_t i = 0; i < number; i++)
#ifdef _WIN32
        _aligned_free(buffers[i].at);
#else
        free(buffers[i].at);
#endif
    number = 0;
}

static Buffer *find(uint64_t key) {
    for (int64_t i = 0; i < number; i++)
        if (buffers[i].key == key) return buffers + i;
    return NULL;
}

static char *place(uint64_t key, uint64_t offset) {
    Buffer *b = find(key);
    if (!b) give_up("an argument lies in memory that was not sent");
    return b->at + offset;
}

static void take_buffers(void) {
    for (uint64_t left = word(); left; left--) {
        const uint64_t key = word(), size = word();
        Buffer *b = find(key);
        if (!b) {
            if (number == MOST_BUFFERS) give_up("too many buffers");
            b = buffers + number++;
            *b = (Buffer){key, size, space(size)};
        }
        if (b->size != size) give_up("a buffer has changed its size");
        take(b->at, size);
    }
}

#ifdef TABLE
#define KERNEL(name) extern void name(void);
#include TABLE
#undef KERNEL
static const struct {
    const char *name;
    Kernel kernel;
} table[] = {
#define KERNEL(name) {#name, name},
#include TABLE
};
static Kernel kernel_of(const char *name) {
    for (size_t i = 0; i < sizeof table / sizeof *table; i++)
        if (!strcmp(table[i].name, name)) return table[i].kernel;
    return NULL;
}
#elif defined(_WIN32)
static HMODULE library;
static Kernel kernel_of(const char *name) { return (Kernel)GetProcAddress(library, name); }
#else
static void *library;
static Kernel kernel_of(const char *name) { return (Kernel)dlsym(library, name); }
#endif

// Whole numbers and pointers fill their registers and then the stack in order, real numbers registers of their own: so
// one type fits all kernels. On Windows a register stands for a position instead, and those on the stack are 8 bytes of
// any kind.
#define I int64_t
#define TEN I, I, I, I, I, I, I, I, I, I
#define A(k) a[k], a[k + 1], a[k + 2], a[k + 3], a[k + 4], a[k + 5], a[k + 6], a[k + 7], a[k + 8], a[k + 9]
#ifdef _WIN32
#define REST I, I, I, I, I, I, TEN, TEN, TEN
#define B a[4], a[5], a[6], a[7], a[8], a[9], A(10), A(20), A(30)
static int64_t run(Kernel kernel, const int64_t *a, const float *f, const uint8_t *is_float) {
    const int which = is_float[0] | is_float[1] << 1 | is_float[2] << 2 | is_float[3] << 3;
    if (which == 0) return ((I(*)(I, I, I, I, REST))kernel)(a[0], a[1], a[2], a[3], B);
    if (which == 6) return ((I(*)(I, float, float, I, REST))kernel)(a[0], f[1], f[2], a[3], B);
    if (which == 8) return ((I(*)(I, I, I, float, REST))kernel)(a[0], a[1], a[2], f[3], B);
    give_up("no call with real numbers at these places");
    return 0;
}
#else
static int64_t run(Kernel kernel, const int64_t *all, const float *floats, const uint8_t *is_float) {
    int64_t a[MOST_ARGUMENTS] = {0};
    float f[MOST_FLOATS] = {0};
    int whole = 0, real = 0;
    for (int k = 0; k < MOST_ARGUMENTS; k++) {
        if (!is_float[k]) a[whole++] = all[k];
        else if (real == MOST_FLOATS) give_up("too many real numbers");
        else f[real++] = floats[k];
    }
    typedef float F;
    return ((I(*)(TEN, TEN, TEN, TEN, F, F, F, F, F, F, F, F))kernel)(A(0), A(10), A(20), A(30), f[0], f[1], f[2], f[3],
                                                                        f[4], f[5], f[6], f[7]);
}
#endif

static void serve(void) {
    char name[64] = {0};
    const uint64_t length = word();
    if (length >= sizeof name) give_up("a long name");
    take(name, length);
    const uint64_t keep = word();
    take_buffers();
    Moved moved[256];
    const uint64_t moves = word();
    if (moves > 256) give_up("too many addresses");
    for (uint64_t i = 0; i < moves;
         i++) {  // addresses within the memory: of Python's, of this process while the kernel runs
        uint64_t where[4];
        take(where, sizeof where);
        moved[i].at = (uint64_t *)place(where[0], where[1]);
        moved[i].before = *moved[i].at;
        moved[i].during = *moved[i].at = (uint64_t)(uintptr_t)place(where[2], where[3]);
    }
    int64_t whole[MOST_ARGUMENTS] = {0};
    float real[MOST_ARGUMENTS] = {0};
    uint8_t is_float[MOST_ARGUMENTS] = {0};
    const uint64_t count = word();
    if (count > MOST_ARGUMENTS) give_up("too many arguments");
    for (uint64_t k = 0; k < count; k++) {
        const uint64_t kind = word();
        if (kind == 'p') {
            const uint64_t key = word(), offset = word();
            whole[k] = (int64_t)(uintptr_t)place(key, offset);
        } else {
            whole[k] = (int64_t)word(), word();
            is_float[k] = kind == 'f';
            memcpy(real + k, whole + k, 4);
        }
    }
    Kernel kernel = kernel_of(name);
    if (!kernel) give_up(name);
    const int64_t result = run(kernel, whole, real, is_float);
    for (uint64_t i = moves; i-- > 0;)  // what an output held before by chance looks like an address, too
        if (*moved[i].at == moved[i].during) *moved[i].at = moved[i].before;
    fwrite(&result, 8, 1, stdout);
    for (int64_t i = 0; i < number; i++) fwrite(buffers[i].at, 1, buffers[i].size, stdout);
    fflush(stdout);
    if (!keep) forget_all();
}

int main(int count, char **arguments) {
#ifdef _WIN32
    _setmode(0, _O_BINARY), _setmode(1, _O_BINARY);
    library = count > 1 ? LoadLibraryA(arguments[1]) : NULL;
    if (!library) give_up("the library cannot be loaded");
#elif !defined(TABLE)
    library = count > 1 ? dlopen(arguments[1], RTLD_NOW) : NULL;
    if (!library) give_up(dlerror());
#else
    (void)count, (void)arguments;
#endif
    for (;;) serve();
}
