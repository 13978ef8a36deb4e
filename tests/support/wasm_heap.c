/* NumPy's allocator in one region: blocks of powers of two, free lists, data at multiples of 64 bytes.
   Where the region is full, memory comes from the system. */
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef struct { void *next; uint64_t size; int order; char unused[44]; } head; /* 64 bytes, before the data */

static atomic_flag busy = ATOMIC_FLAG_INIT;
static char *top, *first, *end;
static head *lists[64];

void heap_start(char *from, char *to) { first = top = from; end = to; }

static void *from_system(size_t n) {
  head *h = NULL;
  if (posix_memalign((void **)&h, 64, n + sizeof(head))) return NULL;
  h->order = -1, h->size = n;
  return h + 1;
}

static void *heap_malloc(void *context, size_t n) {
  int order = 7;
  while (order < 63 && ((size_t)1 << order) < n + sizeof(head)) order++;
  size_t size = (size_t)1 << order;
  head *h = NULL;
  while (atomic_flag_test_and_set(&busy));
  if (lists[order]) h = lists[order], lists[order] = h->next;
  else if (size <= (size_t)(end - top)) h = (head *)top, top += size;
  atomic_flag_clear(&busy);
  if (!h) return from_system(n);
  h->order = order, h->size = n;
  return h + 1;
}

static void *heap_calloc(void *context, size_t count, size_t size) {
  void *p = heap_malloc(context, count * size);
  return p ? memset(p, 0, count * size) : NULL;
}

static void heap_free(void *context, void *p, size_t n) {
  if (!p) return;
  head *h = (head *)p - 1;
  if (h->order < 0) { free(h); return; }
  while (atomic_flag_test_and_set(&busy));
  h->next = lists[h->order], lists[h->order] = h;
  atomic_flag_clear(&busy);
}

static void *heap_realloc(void *context, void *p, size_t n) {
  void *q = heap_malloc(context, n);
  if (q && p) {
    size_t old = ((head *)p - 1)->size;
    memcpy(q, p, old < n ? old : n);
    heap_free(context, p, old);
  }
  return q;
}

/* PyDataMem_Handler */
struct {
  char name[127];
  uint8_t version;
  void *context;
  void *(*malloc)(void *, size_t);
  void *(*calloc)(void *, size_t, size_t);
  void *(*realloc)(void *, void *, size_t);
  void (*free)(void *, void *, size_t);
} handler = {"antumbra tests", 1, NULL, heap_malloc, heap_calloc, heap_realloc, heap_free};
