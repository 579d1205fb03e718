/* Stands between a process and the C library: at the n-th call that changes a watched folder, it fails,
   writes less than it was asked to, or sends the process a signal. Loaded by LD_PRELOAD, armed by fault_arm. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { SIGNAL = 1, ERROR = 2, SHORT = 3 };

static char watched[PATH_MAX];
static int at, kind, number, sticky;
static int *count;  /* shared with the process that armed: how many calls were counted */
static char *told;  /* shared likewise: which call was hit; 256 bytes */

void fault_arm(const char *folder, int call, int what, int value, int goes_on, int *counted, char *name) {
    snprintf(watched, sizeof watched, "%s", folder);
    at = call, kind = what, number = value, sticky = goes_on, count = counted, told = name;
    *count = 0;
}

static int is_watched(int folder, const char *path, int descriptor) {
    char full[PATH_MAX + 64] = "", link[64];
    if (path != NULL && path[0] == '/') {
        snprintf(full, sizeof full, "%s", path);
    } else {
        int of = path == NULL ? descriptor : folder;
        if (path != NULL && folder == AT_FDCWD) {
            if (getcwd(full, PATH_MAX) == NULL) return 0;
        } else {
            snprintf(link, sizeof link, "/proc/self/fd/%d", of);
            ssize_t length = readlink(link, full, PATH_MAX - 1);
            if (length < 0) return 0;
            full[length] = 0;
        }
        if (path != NULL) {
            size_t used = strlen(full);
            snprintf(full + used, sizeof full - used, "/%s", path);
        }
    }
    return strncmp(full, watched, strlen(watched)) == 0;
}

/* 0: go on; ERROR: fail, errno is set; SHORT: write less. */
static int hit(const char *call, int folder, const char *path, int descriptor) {
    if (count == NULL || !is_watched(folder, path, descriptor)) return 0;
    int saved = errno;
    ++*count;
    errno = saved;
    int removes = strncmp(call, "unlink", 6) == 0 || strcmp(call, "rmdir") == 0;  /* a full disk lets files go */
    if (at == 0 || *count < at || (*count > at && (!sticky || removes))) return 0;
    if (*count == at) snprintf(told, 256, "%s %.200s", call, path != NULL ? path : "");
    if (kind == SIGNAL) {
        if (*count == at) raise(number);
        return 0;
    }
    if (kind == ERROR) errno = number;
    return kind;
}

#define REAL(name) static __typeof__(name) *real; if (!real) real = dlsym(RTLD_NEXT, #name)
#define WRITES(flags) ((flags) & (O_CREAT | O_WRONLY | O_RDWR))

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, mode_t); va_end(rest); \
        REAL(name); \
        if (WRITES(flags) && hit(#name, AT_FDCWD, path, -1) == ERROR) return -1; \
        return real(path, flags, mode); \
    }
#define OPENAT(name) \
    int name(int folder, const char *path, int flags, ...) { \
        va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, mode_t); va_end(rest); \
        REAL(name); \
        if (WRITES(flags) && hit(#name, folder, path, -1) == ERROR) return -1; \
        return real(folder, path, flags, mode); \
    }
OPEN(open)
OPEN(open64)
OPENAT(openat)
OPENAT(openat64)

ssize_t write(int descriptor, const void *data, size_t size) {
    REAL(write);
    int what = hit("write", AT_FDCWD, NULL, descriptor);
    if (what == ERROR) return -1;
    return real(descriptor, data, what == SHORT && size > 1 ? size / 2 : size);
}

#define PWRITE(name, offset_type) \
    ssize_t name(int descriptor, const void *data, size_t size, offset_type offset) { \
        REAL(name); \
        int what = hit(#name, AT_FDCWD, NULL, descriptor); \
        if (what == ERROR) return -1; \
        return real(descriptor, data, what == SHORT && size > 1 ? size / 2 : size, offset); \
    }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

ssize_t writev(int descriptor, const struct iovec *pieces, int length) {
    REAL(writev);
    static ssize_t (*one)(int, const void *, size_t);
    if (!one) one = dlsym(RTLD_NEXT, "write");
    int what = hit("writev", AT_FDCWD, NULL, descriptor);
    if (what == ERROR) return -1;
    if (what == SHORT && length > 0) return one(descriptor, pieces->iov_base, (pieces->iov_len + 1) / 2);
    return real(descriptor, pieces, length);
}

#define ON_PATH(name, parameters, path, arguments) \
    int name parameters { REAL(name); if (hit(#name, AT_FDCWD, path, -1) == ERROR) return -1; return real arguments; }
#define ON_FOLDER(name, parameters, folder, path, arguments) \
    int name parameters { REAL(name); if (hit(#name, folder, path, -1) == ERROR) return -1; return real arguments; }
#define ON_FILE(name, parameters, arguments) \
    int name parameters { REAL(name); if (hit(#name, AT_FDCWD, NULL, fd) == ERROR) return -1; return real arguments; }

ON_PATH(rename, (const char *from, const char *to), to, (from, to))
ON_PATH(unlink, (const char *path), path, (path))
ON_PATH(rmdir, (const char *path), path, (path))
ON_PATH(mkdir, (const char *path, mode_t mode), path, (path, mode))
ON_PATH(chmod, (const char *path, mode_t mode), path, (path, mode))
ON_PATH(link, (const char *from, const char *to), to, (from, to))
ON_PATH(symlink, (const char *from, const char *to), to, (from, to))
ON_FOLDER(renameat, (int one, const char *from, int other, const char *to), other, to, (one, from, other, to))
ON_FOLDER(renameat2, (int one, const char *from, int other, const char *to, unsigned flags), other, to, (one, from, other, to, flags))
ON_FOLDER(unlinkat, (int folder, const char *path, int flags), folder, path, (folder, path, flags))
ON_FOLDER(mkdirat, (int folder, const char *path, mode_t mode), folder, path, (folder, path, mode))
ON_FOLDER(fchmodat, (int folder, const char *path, mode_t mode, int flags), folder, path, (folder, path, mode, flags))
ON_FOLDER(linkat, (int one, const char *from, int other, const char *to, int flags), other, to, (one, from, other, to, flags))
ON_FILE(fsync, (int fd), (fd))
ON_FILE(fdatasync, (int fd), (fd))
ON_FILE(fchmod, (int fd, mode_t mode), (fd, mode))
ON_FILE(ftruncate, (int fd, off_t length), (fd, length))
ON_FILE(ftruncate64, (int fd, off64_t length), (fd, length))
