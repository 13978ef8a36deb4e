/* A CUDA driver for tests: device memory is memory of the host, and kernels are functions of the host, registered by
   name. Any function can be told to fail. Functions that need a context fail without one. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API
#endif

typedef void (*kernel_t)(const int64_t *words, int64_t blocks, int64_t block);
enum { OK, INVALID_VALUE, OUT_OF_MEMORY, INVALID_CONTEXT = 201, NOT_FOUND = 500, NOT_READY = 600 };

static struct { char name[64]; int status; } failures[8];
static struct { char name[64]; kernel_t run; int words; } kernels[256];
static int n_kernels, devices = 1, version = 12040, capability = 90, mode, pending, live, streams, events, pinned;
static uint64_t total = 1u << 30, used;
static _Thread_local int depth; /* contexts pushed by this thread */

static int failing(const char *name) {
  for (int i = 0; i < 8; i++)
    if (failures[i].status && !strcmp(failures[i].name, name)) return failures[i].status;
  return OK;
}
#define TRY do { int status = failing(__func__); if (status) return status; } while (0)
#define TRY_IN_CONTEXT do { TRY; if (!depth) return INVALID_CONTEXT; } while (0)

API void fake_reset(void) {
  memset(failures, 0, sizeof failures);
  n_kernels = 0; devices = 1; version = 12040; capability = 90; mode = 0; pending = 0; total = 1u << 30;
}
API void fake_fail(const char *name, int status) {
  for (int i = 0; i < 8; i++)
    if (!failures[i].status) { strncpy(failures[i].name, name, 63); failures[i].status = status; return; }
}
API void fake_set(int new_devices, int new_version, int new_capability, int new_mode) {
  devices = new_devices; version = new_version; capability = new_capability; mode = new_mode;
}
API void fake_pend(int queries) { pending = queries; } /* events are not ready for so many queries; -1: never */
API void fake_register(const char *name, kernel_t run, int words) {
  if (n_kernels == sizeof kernels / sizeof *kernels || words > 128) abort();
  strncpy(kernels[n_kernels].name, name, 63); kernels[n_kernels].run = run; kernels[n_kernels++].words = words;
}
API void fake_counts(int *out) { out[0] = live; out[1] = streams; out[2] = events; out[3] = pinned; out[4] = depth; }

API int cuInit(unsigned flags) { TRY; return OK; }
API int cuDriverGetVersion(int *out) { TRY; *out = version; return OK; }
API int cuGetErrorName(int status, const char **out) {
  static const struct { int status; const char *name; } names[] = {
    {1, "CUDA_ERROR_INVALID_VALUE"}, {2, "CUDA_ERROR_OUT_OF_MEMORY"}, {3, "CUDA_ERROR_NOT_INITIALIZED"},
    {46, "CUDA_ERROR_DEVICE_UNAVAILABLE"}, {100, "CUDA_ERROR_NO_DEVICE"}, {201, "CUDA_ERROR_INVALID_CONTEXT"},
    {218, "CUDA_ERROR_INVALID_PTX"}, {500, "CUDA_ERROR_NOT_FOUND"}, {700, "CUDA_ERROR_ILLEGAL_ADDRESS"},
    {702, "CUDA_ERROR_LAUNCH_TIMEOUT"}, {803, "CUDA_ERROR_SYSTEM_DRIVER_MISMATCH"}};
  for (unsigned i = 0; i < sizeof names / sizeof *names; i++)
    if (names[i].status == status) { *out = names[i].name; return OK; }
  return INVALID_VALUE;
}
API int cuDeviceGetCount(int *out) { TRY; *out = devices; return OK; }
API int cuDeviceGet(int *out, int ordinal) { TRY; *out = ordinal; return OK; }
API int cuDeviceGetName(char *out, int size, int device) { TRY; strncpy(out, "Fake card", size); return OK; }
API int cuDeviceGetAttribute(int *out, int which, int device) {
  TRY;
  *out = which == 75 ? capability / 10 : which == 76 ? capability % 10 : which == 20 ? mode : -1;
  return OK;
}
API int cuDevicePrimaryCtxRetain(void **out, int device) { TRY; *out = &total; return OK; }
API int cuCtxPushCurrent_v2(void *context) { TRY; if (context != &total) return INVALID_CONTEXT; depth++; return OK; }
API int cuCtxPopCurrent_v2(void **out) { TRY; if (!depth) return INVALID_CONTEXT; depth--; *out = &total; return OK; }

API int cuMemGetInfo_v2(size_t *free_bytes, size_t *all) {
  TRY_IN_CONTEXT; *free_bytes = total - used; *all = total; return OK;
}
static void *block(size_t size) { /* its size in front of it, filled with a pattern */
  char *start = malloc(size + 512), *at = (char *)(((uintptr_t)start + 511) & ~(uintptr_t)255);
  ((void **)at)[-1] = start; ((size_t *)at)[-2] = size; memset(at, 0xCD, size); return at;
}
API int cuMemAlloc_v2(uint64_t *out, size_t size) {
  TRY_IN_CONTEXT; if (used + size > total) return OUT_OF_MEMORY;
  used += size; live++; *out = (uint64_t)block(size); return OK;
}
API int cuMemFree_v2(uint64_t at) {
  TRY_IN_CONTEXT; used -= ((size_t *)at)[-2]; live--; free(((void **)at)[-1]); return OK;
}
API int cuMemHostAlloc(void **out, size_t size, unsigned flags) { TRY_IN_CONTEXT; pinned++; *out = block(size); return OK; }
API int cuMemFreeHost(void *at) { TRY_IN_CONTEXT; pinned--; free(((void **)at)[-1]); return OK; }
API int cuMemcpyHtoDAsync_v2(uint64_t to, const void *from, size_t size, void *stream) {
  TRY_IN_CONTEXT; memcpy((void *)to, from, size); return OK;
}
API int cuMemcpyDtoHAsync_v2(void *to, uint64_t from, size_t size, void *stream) {
  TRY_IN_CONTEXT; memcpy(to, (void *)from, size); return OK;
}
API int cuMemsetD8Async(uint64_t to, unsigned char byte, size_t size, void *stream) {
  TRY_IN_CONTEXT; memset((void *)to, byte, size); return OK;
}

API int cuStreamCreate(void **out, unsigned flags) {
  static int handles; /* never reused, though the number of streams falls */
  TRY_IN_CONTEXT; streams++; *out = (void *)(uintptr_t)(0x1000 + 16 * ++handles); return OK;
}
API int cuStreamDestroy_v2(void *stream) { TRY_IN_CONTEXT; streams--; return OK; }
API int cuStreamWaitEvent(void *stream, void *event, unsigned flags) { TRY_IN_CONTEXT; return OK; }
API int cuEventCreate(void **out, unsigned flags) { TRY_IN_CONTEXT; events++; *out = calloc(1, 8); return OK; }
API int cuEventDestroy_v2(void *event) { TRY_IN_CONTEXT; events--; free(event); return OK; }
API int cuEventRecord(void *event, void *stream) {
  static int64_t clock; TRY_IN_CONTEXT; *(int64_t *)event = clock++; return OK;
}
API int cuEventQuery(void *event) {
  TRY_IN_CONTEXT; if (!pending) return OK;
  pending -= pending > 0; return NOT_READY;
}
API int cuEventElapsedTime(float *out, void *from, void *to) {
  TRY_IN_CONTEXT; *out = (float)(*(int64_t *)to - *(int64_t *)from); return OK;
}

API int cuModuleLoadDataEx(void **out, const void *image, unsigned n, int *options, void **values) {
  int status = failing(__func__);
  if (!depth) return INVALID_CONTEXT;
  if (status) { strncpy(values[0], "ptxas error: line 7: syntax error\n", (size_t)values[1]); return status; }
  *out = (void *)image; return OK;
}
API int cuModuleGetFunction(void **out, void *module, const char *name) {
  TRY_IN_CONTEXT;
  for (int i = 0; i < n_kernels; i++)
    if (!strcmp(kernels[i].name, name)) { *out = &kernels[i]; return OK; }
  return NOT_FOUND;
}
API int cuFuncGetAttribute(int *out, int which, void *function) { TRY_IN_CONTEXT; *out = which; return OK; }
API int cuLaunchKernel(void *function, unsigned gx, unsigned gy, unsigned gz, unsigned bx, unsigned by, unsigned bz,
                       unsigned shared, void *stream, void **parameters, void **extra) {
  int64_t words[128];
  TRY_IN_CONTEXT;
  for (int i = 0; i < n_kernels; i++)
    if (function == &kernels[i]) {
      for (int k = 0; k < kernels[i].words; k++) memcpy(&words[k], parameters[k], 8);
      kernels[i].run(words, gx, bx);
    }
  return OK;
}
