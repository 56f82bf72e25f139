// Compiles CUDA C++ with NVRTC for one architecture, and prints what NVIDIA's compiler says of each kernel.
//
// The argument is `sm_90` or `sm_89`. Standard input is the file `launches` of `driver.c`. Standard output has a line for each kernel:
// the name without its form, and statistics as `name=value`, separated by tabs, by the names that RADV has for them
// (`statistics.c`): the warps that a multiprocessor holds stand for `Subgroups per SIMD`. A kernel that does not compile has `failed=CODE`.
// `.ci/run cards` compiles and uses this program.
//
// A multiprocessor holds as many cubes as the least of these allows, by NVIDIA's calculator of occupancy:
//
//     warps         floor(warps of a multiprocessor / w)                 w = ceil(units of a cube / 32)
//     registers     floor(floor4(65,536 / r) / w)                        r = ceil256(32 · registers of a unit); floor4: to a multiple of 4
//     shared memory floor(bytes of a multiprocessor / ceil128(bytes of a cube + 1,024))
//     cubes         those that a multiprocessor may hold
//
// The warps are w times the cubes.
#include <elf.h>
#include <nvrtc.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Bytes of an instruction.
#define INSTRUCTION 16

// The end of a kernel's name. What follows tells its forms apart.
#define SUFFIX "_kernel"

struct architecture {
    const char *name;
    // As CubeCL asks for it.
    const char *option;
    unsigned warps, cubes, shared_bytes;
};

static const struct architecture architectures[] = {
    {"sm_90", "--gpu-architecture=sm_90a", 64, 32, 228 << 10},
    {"sm_89", "--gpu-architecture=sm_89", 48, 24, 100 << 10},
};

struct needs {
    unsigned registers, shared_bytes, spilled_bytes;
};

static void must(nvrtcResult result, const char *what) {
    if (result == NVRTC_SUCCESS) return;
    fprintf(stderr, "%s: %s\n", what, nvrtcGetErrorString(result));
    exit(1);
}

static void *room(size_t bytes) {
    void *memory = calloc(1, bytes);
    if (memory) return memory;
    fprintf(stderr, "no memory for %zu bytes\n", bytes);
    exit(1);
}

static char *file_contents(const char *path) {
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END)) {
        perror(path);
        exit(1);
    }
    size_t size = ftell(file);
    rewind(file);
    char *contents = room(size + 1);
    if (fread(contents, 1, size, file) != size) {
        perror(path);
        exit(1);
    }
    fclose(file);
    return contents;
}

// Returns the number before a text in the compiler's log, or zero.
static unsigned before(const char *log, const char *text) {
    const char *at = strstr(log, text);
    if (!at) return 0;
    while (at > log && at[-1] == ' ') at--;
    while (at > log && at[-1] >= '0' && at[-1] <= '9') at--;
    return atoi(at);
}

// Returns the size of a kernel's machine code. It ends in up to a few instructions that fill a line of the cache.
static size_t code_bytes(const char *cubin, const char *kernel) {
    const Elf64_Ehdr *head = (const Elf64_Ehdr *)cubin;
    const Elf64_Shdr *sections = (const Elf64_Shdr *)(cubin + head->e_shoff);
    const char *names = cubin + sections[head->e_shstrndx].sh_offset;
    for (int i = 0; i < head->e_shnum; i++) {
        const char *name = names + sections[i].sh_name;
        if (!strncmp(name, ".text.", 6) && !strcmp(name + 6, kernel)) return sections[i].sh_size;
    }
    return 0;
}

static unsigned up(unsigned value, unsigned multiple) { return (value + multiple - 1) / multiple * multiple; }

static unsigned least(unsigned a, unsigned b) { return a < b ? a : b; }

static unsigned warps(const struct architecture *on, struct needs needs, unsigned units) {
    unsigned w = up(units, 32) / 32;
    unsigned by_registers = 65536 / up(32 * needs.registers, 256) / 4 * 4 / w;
    unsigned by_shared_memory = on->shared_bytes / up(needs.shared_bytes + 1024, 128);
    return w * least(least(on->cubes, on->warps / w), least(by_registers, by_shared_memory));
}

static void compile(const struct architecture *on, const char *path, const char *kernel, unsigned units, unsigned shared_bytes) {
    const char *options[] = {on->option, "-lineinfo", "--ptxas-options=-v"};
    nvrtcProgram program;
    size_t size;
    char *source = file_contents(path);
    must(nvrtcCreateProgram(&program, source, NULL, 0, NULL, NULL), path);
    nvrtcResult result = nvrtcCompileProgram(program, 3, options);
    must(nvrtcGetProgramLogSize(program, &size), path);
    char *log = room(size + 1);
    must(nvrtcGetProgramLog(program, log), path);
    printf("%.*s", (int)(strstr(kernel, SUFFIX) + strlen(SUFFIX) - kernel), kernel);
    if (result != NVRTC_SUCCESS) {
        printf("\tfailed=%d\n", result);
        fprintf(stderr, "%s: %s\n%s\n", on->name, kernel, log);
    } else {
        struct needs needs = {
            .registers = before(log, "registers"),
            .shared_bytes = before(log, "bytes smem") + shared_bytes,
            .spilled_bytes = before(log, "bytes spill stores"),
        };
        must(nvrtcGetCUBINSize(program, &size), path);
        char *cubin = room(size);
        must(nvrtcGetCUBIN(program, cubin), path);
        printf("\tSubgroups per SIMD=%u\tVGPRs=%u\tLDS size=%u\tInstructions=%zu\tSpilled VGPRs=%u\n", warps(on, needs, units),
               needs.registers, needs.shared_bytes, code_bytes(cubin, kernel) / INSTRUCTION, needs.spilled_bytes / 4);
        free(cubin);
    }
    fflush(stdout);
    free(log);
    free(source);
    must(nvrtcDestroyProgram(&program), path);
}

int main(int count, char **arguments) {
    const struct architecture *on = NULL;
    for (size_t i = 0; count == 2 && i < sizeof architectures / sizeof *architectures; i++) {
        if (!strcmp(arguments[1], architectures[i].name)) on = &architectures[i];
    }
    if (!on) {
        fprintf(stderr, "usage: nvrtc sm_90|sm_89 <launches\n");
        return 2;
    }
    char line[8192];
    while (fgets(line, sizeof line, stdin)) {
        char *path = strtok(line, "\t"), *kernel = strtok(NULL, "\t"), *units = strtok(NULL, "\t"), *shared_bytes = strtok(NULL, "\n");
        if (!path || !kernel || !strstr(kernel, SUFFIX) || !units || !shared_bytes) {
            fprintf(stderr, "a line needs a file, a name with %s, units, and bytes of shared memory\n", SUFFIX);
            return 1;
        }
        compile(on, path, kernel, atoi(units), atoi(shared_bytes));
    }
    return 0;
}
