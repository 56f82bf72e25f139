// A driver of CUDA and a compiler NVRTC without a card, as one library: devices of compute capability SPLAT_CAPABILITY (90 or 89), memory
// of the host, and launches that do nothing but write what was launched. CubeCL so emits the CUDA C++ of every kernel that it launches.
//
// A source goes to a file of its own in the folder SPLAT_SOURCES when NVRTC is asked to compile it. `launches` in that folder has a line for
// each kernel and source: file, name of the kernel, units of a cube, and dynamic shared memory of a cube, bytes, separated by tabs.
// `.ci/run cards` compiles and loads this library, and gives the sources to the true NVRTC (`nvrtc.c`).
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SUCCESS 0
#define OUT_OF_MEMORY 2
#define INVALID_DEVICE 101
#define NOT_SUPPORTED 801

typedef uint64_t Pointer;
typedef void *Handle;

// CUdevice_attribute.
enum {
    MAX_UNITS = 1, MAX_CUBE_X, MAX_CUBE_Y, MAX_CUBE_Z, MAX_GRID_X, MAX_GRID_Y, MAX_GRID_Z, SHARED_BYTES, WARP = 10, MULTIPROCESSORS = 16,
    UNITS_OF_MULTIPROCESSOR = 39, MAJOR = 75, MINOR = 76, SHARED_OF_MULTIPROCESSOR = 81, MAX_SHARED_BYTES = 97, MEMORY_POOLS = 115,
};

// A program of NVRTC, the module that is loaded from its PTX, and the module's only function.
struct kernel {
    char file[4096];
    char name[512];
    int written;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static int capability(void) {
    const char *text = getenv("SPLAT_CAPABILITY");
    return text ? atoi(text) : 90;
}

static const char *folder(void) {
    const char *path = getenv("SPLAT_SOURCES");
    if (path) return path;
    fprintf(stderr, "SPLAT_SOURCES names no folder\n");
    exit(1);
}

static FILE *opened(const char *path, const char *mode) {
    FILE *file = fopen(path, mode);
    if (file) return file;
    perror(path);
    exit(1);
}

int cuInit(unsigned flags) { return SUCCESS; }

int cuDriverGetVersion(int *version) {
    *version = 13000;
    return SUCCESS;
}

int cuGetErrorName(int error, const char **name) {
    *name = "an error without a card";
    return SUCCESS;
}

int cuGetErrorString(int error, const char **text) { return cuGetErrorName(error, text); }

int cuDeviceGetCount(int *count) {
    *count = 1;
    return SUCCESS;
}

int cuDeviceGet(int *device, int ordinal) {
    *device = ordinal;
    return ordinal ? INVALID_DEVICE : SUCCESS;
}

int cuDeviceGetName(char *name, int size, int device) {
    snprintf(name, size, "no card of compute capability %d.%d", capability() / 10, capability() % 10);
    return SUCCESS;
}

int cuDeviceTotalMem_v2(size_t *bytes, int device) {
    *bytes = (size_t)8 << 30;
    return SUCCESS;
}

int cuDeviceGetPCIBusId(char *id, int size, int device) {
    snprintf(id, size, "0000:01:00.0");
    return SUCCESS;
}

int cuDeviceGetUuid_v2(char *uuid, int device) {
    memset(uuid, 1, 16);
    return SUCCESS;
}

int cuDeviceGetAttribute(int *value, int attribute, int device) {
    int ninety = capability() >= 90;
    switch (attribute) {
    case MAX_UNITS: case MAX_CUBE_X: case MAX_CUBE_Y: *value = 1024; break;
    case MAX_CUBE_Z: *value = 64; break;
    case MAX_GRID_X: *value = 2147483647; break;
    case MAX_GRID_Y: case MAX_GRID_Z: *value = 65535; break;
    case SHARED_BYTES: *value = 49152; break;
    case WARP: *value = 32; break;
    case MULTIPROCESSORS: *value = ninety ? 132 : 128; break;
    case UNITS_OF_MULTIPROCESSOR: *value = ninety ? 2048 : 1536; break;
    case MAJOR: *value = capability() / 10; break;
    case MINOR: *value = capability() % 10; break;
    case SHARED_OF_MULTIPROCESSOR: *value = ninety ? 233472 : 102400; break;
    case MAX_SHARED_BYTES: *value = ninety ? 232448 : 101376; break;
    case MEMORY_POOLS: *value = 1; break;
    default: *value = 0;
    }
    return SUCCESS;
}

int cuDevicePrimaryCtxRetain(Handle *context, int device) {
    *context = (Handle)1;
    return SUCCESS;
}

int cuDevicePrimaryCtxRelease_v2(int device) { return SUCCESS; }

int cuCtxSetCurrent(Handle context) { return SUCCESS; }

int cuCtxGetCurrent(Handle *context) {
    *context = (Handle)1;
    return SUCCESS;
}

int cuCtxSynchronize(void) { return SUCCESS; }

int cuCtxGetStreamPriorityRange(int *least, int *greatest) {
    *least = 0;
    *greatest = -5;
    return SUCCESS;
}

int cuStreamCreate(Handle *stream, unsigned flags) {
    *stream = malloc(1);
    return SUCCESS;
}

int cuStreamCreateWithPriority(Handle *stream, unsigned flags, int priority) { return cuStreamCreate(stream, flags); }

int cuStreamSynchronize(Handle stream) { return SUCCESS; }

int cuStreamDestroy_v2(Handle stream) {
    free(stream);
    return SUCCESS;
}

int cuStreamWaitEvent(Handle stream, Handle event, unsigned flags) { return SUCCESS; }

int cuStreamIsCapturing(Handle stream, int *capturing) {
    *capturing = 0;
    return SUCCESS;
}

int cuStreamBeginCapture_v2(Handle stream, int mode) { return NOT_SUPPORTED; }

int cuEventCreate(Handle *event, unsigned flags) {
    *event = malloc(1);
    return SUCCESS;
}

int cuEventRecord(Handle event, Handle stream) { return SUCCESS; }

int cuEventSynchronize(Handle event) { return SUCCESS; }

int cuEventQuery(Handle event) { return SUCCESS; }

int cuEventDestroy_v2(Handle event) {
    free(event);
    return SUCCESS;
}

// Every word of device memory is 1 until something is copied there: a count that no kernel writes is then one, neither zero nor huge.
static void *allocated(size_t bytes) {
    size_t words = bytes / 4 + 64;
    uint32_t *memory = NULL;
    if (posix_memalign((void **)&memory, 4096, 4 * words)) return NULL;
    for (size_t i = 0; i < words; i++) memory[i] = 1;
    return memory;
}

int cuMemAlloc_v2(Pointer *pointer, size_t bytes) {
    *pointer = (Pointer)allocated(bytes);
    return *pointer ? SUCCESS : OUT_OF_MEMORY;
}

int cuMemAllocAsync(Pointer *pointer, size_t bytes, Handle stream) { return cuMemAlloc_v2(pointer, bytes); }

int cuMemFree_v2(Pointer pointer) {
    free((void *)pointer);
    return SUCCESS;
}

int cuMemFreeAsync(Pointer pointer, Handle stream) { return cuMemFree_v2(pointer); }

int cuMemAllocHost_v2(void **pointer, size_t bytes) {
    *pointer = allocated(bytes);
    return *pointer ? SUCCESS : OUT_OF_MEMORY;
}

int cuMemHostAlloc(void **pointer, size_t bytes, unsigned flags) { return cuMemAllocHost_v2(pointer, bytes); }

int cuMemFreeHost(void *pointer) {
    free(pointer);
    return SUCCESS;
}

int cuMemGetInfo_v2(size_t *unused, size_t *total) {
    cuDeviceTotalMem_v2(total, 0);
    *unused = *total;
    return SUCCESS;
}

// Nothing is written to device memory, so that kernels that did not run leave no bits of NaN, with which tests fill it.
int cuMemcpyHtoDAsync_v2(Pointer to, const void *from, size_t bytes, Handle stream) {
    return SUCCESS;
}

int cuMemcpyDtoHAsync_v2(void *to, Pointer from, size_t bytes, Handle stream) {
    memcpy(to, (void *)from, bytes);
    return SUCCESS;
}

int cuMemcpyDtoDAsync_v2(Pointer to, Pointer from, size_t bytes, Handle stream) {
    return SUCCESS;
}

int cuMemcpy2DAsync_v2(const void *copy, Handle stream) { return SUCCESS; }

int cuMemsetD8Async(Pointer to, unsigned char value, size_t bytes, Handle stream) {
    return SUCCESS;
}

int nvrtcVersion(int *major, int *minor) {
    *major = 13;
    *minor = 0;
    return SUCCESS;
}

const char *nvrtcGetErrorString(int error) { return "an error without NVRTC"; }

int nvrtcCreateProgram(Handle *program, const char *source, const char *name, int headers, const char *const *texts, const char *const *names) {
    static int sources;
    struct kernel *made = calloc(1, sizeof *made);
    pthread_mutex_lock(&lock);
    snprintf(made->file, sizeof made->file, "%s/%05d.cu", folder(), sources++);
    pthread_mutex_unlock(&lock);
    FILE *file = opened(made->file, "w");
    fputs(source, file);
    fclose(file);
    *program = made;
    return SUCCESS;
}

int nvrtcCompileProgram(Handle program, int count, const char *const *options) {
    return SUCCESS;
}

int nvrtcGetProgramLogSize(Handle program, size_t *bytes) {
    *bytes = 1;
    return SUCCESS;
}

int nvrtcGetProgramLog(Handle program, char *text) {
    *text = 0;
    return SUCCESS;
}

// The PTX is the file's name.
int nvrtcGetPTXSize(Handle program, size_t *bytes) {
    *bytes = strlen(((struct kernel *)program)->file) + 1;
    return SUCCESS;
}

int nvrtcGetPTX(Handle program, char *ptx) {
    strcpy(ptx, ((struct kernel *)program)->file);
    return SUCCESS;
}

int nvrtcDestroyProgram(Handle *program) {
    free(*program);
    return SUCCESS;
}

int cuModuleLoadData(Handle *module, const void *ptx) {
    struct kernel *loaded = calloc(1, sizeof *loaded);
    snprintf(loaded->file, sizeof loaded->file, "%s", (const char *)ptx);
    *module = loaded;
    return SUCCESS;
}

int cuModuleGetFunction(Handle *function, Handle module, const char *name) {
    struct kernel *loaded = module;
    snprintf(loaded->name, sizeof loaded->name, "%s", name);
    *function = loaded;
    return SUCCESS;
}

int cuModuleUnload(Handle module) {
    free(module);
    return SUCCESS;
}

int cuFuncSetAttribute(Handle function, int attribute, int value) { return SUCCESS; }

int cuFuncGetAttribute(int *value, int attribute, Handle function) {
    *value = 0;
    return SUCCESS;
}

int cuLaunchKernel(Handle function, unsigned grid_x, unsigned grid_y, unsigned grid_z, unsigned x, unsigned y, unsigned z,
                   unsigned shared_bytes, Handle stream, void **arguments, void **extra) {
    struct kernel *launched = function;
    pthread_mutex_lock(&lock);
    if (!launched->written) {
        char path[4096];
        snprintf(path, sizeof path, "%s/launches", folder());
        FILE *file = opened(path, "a");
        fprintf(file, "%s\t%s\t%u\t%u\n", launched->file, launched->name, x * y * z, shared_bytes);
        fclose(file);
        launched->written = 1;
    }
    pthread_mutex_unlock(&lock);
    return SUCCESS;
}
