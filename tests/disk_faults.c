/* A file system that fails, or whose every change is written down: preloaded by tests, see faulty_disk.py.

   It concerns what lies below MRM_FAULT_ROOT, in every process that inherits the environment. MRM_FAULT_STATE is a
   file of three 64-bit numbers that they share: how many changes there were, at which one the disk is full (0: never),
   and whether it stays so (1) or has room again with the next (0). With MRM_FAULT_LOG each change is appended to
   that file: a line, and the bytes that were written. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdio_ext.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

struct state { int64_t count, at, stays; };

static struct state *state;
static char root[PATH_MAX];
static size_t root_length;
static int log_file = -1;

#define REAL(name) static __typeof__(&name) real; if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

__attribute__((constructor)) static void begin(void)
{
    const char *place = getenv("MRM_FAULT_ROOT"), *shared = getenv("MRM_FAULT_STATE"), *log = getenv("MRM_FAULT_LOG");
    if (!place || !shared)
        return;
    int file = open(shared, O_RDWR | O_CLOEXEC);
    if (file < 0)
        return;
    state = mmap(NULL, sizeof *state, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (state == MAP_FAILED) {
        state = NULL;
        return;
    }
    if (log)
        log_file = fcntl(open(log, O_WRONLY | O_APPEND | O_CLOEXEC), F_DUPFD_CLOEXEC, 500);
    root_length = strlen(place);
    memcpy(root, place, root_length + 1);
}

static int is_below(const char *path)
{
    return !strncmp(path, root, root_length) && (path[root_length] == '/' || !path[root_length]);
}

/* Where a name leads, links aside; whether that is below the root. */
static int concerns(int folder, const char *name, char *found)
{
    found[0] = 0;
    if (!state || !root_length || !name)
        return 0;
    if (name[0] == '/') {
        snprintf(found, PATH_MAX, "%s", name);
    } else {
        char link[64], base[PATH_MAX];
        ssize_t length = 0;
        if (folder == AT_FDCWD) {
            if (!getcwd(base, sizeof base))
                return 0;
        } else {
            snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
            length = readlink(link, base, sizeof base - 1);
            if (length < 0)
                return 0;
            base[length] = 0;
        }
        if (snprintf(found, PATH_MAX, "%s/%s", base, name) >= PATH_MAX)
            return 0;
    }
    return is_below(found);
}

static int concerns_file(int file, char *found)
{
    struct stat about;
    char link[64];
    if (!state || !root_length || fstat(file, &about) || !(S_ISREG(about.st_mode) || S_ISDIR(about.st_mode)))
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, found, PATH_MAX - 1);
    if (length < 0)
        return 0;
    found[length] = 0;
    return is_below(found);
}

/* Count a change: 0 where it may be made, 1 where the disk is full from now on, 2 where it was already. */
static int full(void)
{
    int64_t count = __atomic_add_fetch(&state->count, 1, __ATOMIC_SEQ_CST);
    int64_t at = state->at;
    if (!at || count < at || (count > at && !state->stays))
        return 0;
    errno = ENOSPC;
    return count == at ? 1 : 2;
}

static void tell(const char *what, uint64_t inode, int64_t number, const char *one, const char *other,
                 const void *data, size_t size)
{
    if (log_file < 0)
        return;
    int before = errno;
    char line[3 * PATH_MAX];
    int length = snprintf(line, sizeof line, "%s\t%llu\t%lld\t%zu\t%s\t%s\n", what, (unsigned long long)inode,
                          (long long)number, size, one, other);
    struct iovec parts[] = {{line, length}, {(void *)data, size}};
    if (writev(log_file, parts, 2) < 0)
        abort();
    errno = before;
}

static uint64_t inode_of(int folder, const char *name)
{
    struct stat about;
    return fstatat(folder, name, &about, AT_SYMLINK_NOFOLLOW) ? 0 : about.st_ino;
}

static uint64_t inode_of_file(int file)
{
    struct stat about;
    return fstat(file, &about) ? 0 : about.st_ino;
}

/* Opening: a change where the file is made or emptied. */
static int opened(int file, int made, int flags, const char *found)
{
    if (file >= 0 && made)
        tell("create", inode_of_file(file), 0, found, "", NULL, 0);
    else if (file >= 0 && (flags & O_TRUNC))
        tell("truncate", inode_of_file(file), 0, "", "", NULL, 0);
    return file;
}

#define OPEN(name, parameters, folder, call)                                                  \
    int name parameters                                                                       \
    {                                                                                         \
        REAL(name);                                                                           \
        mode_t mode = 0;                                                                      \
        if (flags & (O_CREAT | __O_TMPFILE)) {                                                \
            va_list more;                                                                     \
            va_start(more, flags);                                                            \
            mode = va_arg(more, mode_t);                                                      \
            va_end(more);                                                                     \
        }                                                                                     \
        char found[PATH_MAX];                                                                 \
        int nameless = (flags & __O_TMPFILE) == __O_TMPFILE;                                  \
        if (!((flags & O_CREAT) || nameless || (flags & O_TRUNC)) || !concerns(folder, path, found)) \
            return call;                                                                      \
        int made = nameless || ((flags & O_CREAT) && !inode_of(folder, path));                \
        if (made && full())                                                                   \
            return -1;                                                                        \
        return opened(call, made, flags, nameless ? "" : found);                              \
    }

OPEN(open, (const char *path, int flags, ...), AT_FDCWD, real(path, flags, mode))
OPEN(open64, (const char *path, int flags, ...), AT_FDCWD, real(path, flags, mode))
OPEN(openat, (int folder, const char *path, int flags, ...), folder, real(folder, path, flags, mode))
OPEN(openat64, (int folder, const char *path, int flags, ...), folder, real(folder, path, flags, mode))

#define FOPEN(name)                                                                           \
    FILE *name(const char *path, const char *mode)                                            \
    {                                                                                         \
        REAL(name);                                                                           \
        char found[PATH_MAX];                                                                 \
        if (mode[0] == 'r' || !concerns(AT_FDCWD, path, found))                               \
            return real(path, mode);                                                          \
        int made = !inode_of(AT_FDCWD, path);                                                 \
        if (made && full())                                                                   \
            return NULL;                                                                      \
        FILE *file = real(path, mode);                                                        \
        if (file)                                                                             \
            opened(fileno(file), made, mode[0] == 'w' ? O_TRUNC : 0, found);                  \
        return file;                                                                          \
    }

FOPEN(fopen)
FOPEN(fopen64)

/* Writing: the first that fails writes half, as a disk that fills up does. */
static ssize_t written(int file, ssize_t count, off_t at, const void *data)
{
    if (count > 0 && log_file >= 0) {
        if (at < 0)
            at = lseek(file, 0, SEEK_CUR) - count;
        tell("write", inode_of_file(file), at, "", "", data, count);
    }
    return count;
}

static size_t room_for(size_t count, int how)
{
    return how == 1 && state->stays ? count / 2 : 0;
}

ssize_t write(int file, const void *data, size_t count)
{
    REAL(write);
    char found[PATH_MAX];
    if (!count || !concerns_file(file, found))
        return real(file, data, count);
    int how = full();
    if (how && !(count = room_for(count, how)))
        return -1;
    return written(file, real(file, data, count), -1, data);
}

#define PWRITE(name, offset)                                                                  \
    ssize_t name(int file, const void *data, size_t count, offset at)                         \
    {                                                                                         \
        REAL(name);                                                                           \
        char found[PATH_MAX];                                                                 \
        if (!count || !concerns_file(file, found))                                            \
            return real(file, data, count, at);                                               \
        int how = full();                                                                     \
        if (how && !(count = room_for(count, how)))                                           \
            return -1;                                                                        \
        return written(file, real(file, data, count, at), at, data);                          \
    }

PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

ssize_t writev(int file, const struct iovec *parts, int count)
{
    REAL(writev);
    char found[PATH_MAX];
    if (file == log_file || !concerns_file(file, found))
        return real(file, parts, count);
    ssize_t done = 0;
    for (int i = 0; i < count; ++i) {
        ssize_t each = parts[i].iov_len ? write(file, parts[i].iov_base, parts[i].iov_len) : 0;
        if (each < 0)
            return done ? done : -1;
        done += each;
        if ((size_t)each < parts[i].iov_len)
            break;
    }
    return done;
}

/* Whoever copies within the kernel copies by hand where that is refused. */
#define BY_HAND(name, parameters, arguments)                                                  \
    ssize_t name parameters                                                                   \
    {                                                                                         \
        REAL(name);                                                                           \
        char found[PATH_MAX];                                                                 \
        if (!concerns_file(to, found))                                                        \
            return real arguments;                                                            \
        if (log_file >= 0) {                                                                  \
            errno = EINVAL;                                                                   \
            return -1;                                                                        \
        }                                                                                     \
        int how = full();                                                                     \
        if (how && !(count = room_for(count, how)))                                           \
            return -1;                                                                        \
        return real arguments;                                                                \
    }

ssize_t sendfile(int, int, off_t *, size_t);
ssize_t sendfile64(int, int, off64_t *, size_t);
BY_HAND(sendfile, (int to, int from, off_t *at, size_t count), (to, from, at, count))
BY_HAND(sendfile64, (int to, int from, off64_t *at, size_t count), (to, from, at, count))
BY_HAND(copy_file_range, (int from, off64_t *at, int to, off64_t *there, size_t count, unsigned flags),
        (from, at, to, there, count, flags))

/* C's own streams write what they gathered without a call that could be caught here. */
size_t fwrite(const void *data, size_t size, size_t count, FILE *stream)
{
    REAL(fwrite);
    char found[PATH_MAX];
    int file = fileno(stream);
    if (file >= 0 && size && count && concerns_file(file, found) && full())
        return 0;
    return real(data, size, count, stream);
}

static int flushed(FILE *stream, int (*real)(FILE *))
{
    char found[PATH_MAX];
    int file = stream ? fileno(stream) : -1;
    if (file < 0 || !__fwritable(stream) || !concerns_file(file, found))
        return real(stream);
    if (__fpending(stream) && full()) {
        __fpurge(stream);
        real(stream);
        errno = ENOSPC;
        return EOF;
    }
    int copy = log_file < 0 ? -1 : dup(file);
    int done = real(stream);
    if (copy >= 0) {
        /* Written by name, so the name can be read. */
        struct stat about;
        int reading = open(found, O_RDONLY | O_CLOEXEC);
        if (reading >= 0 && !fstat(reading, &about) && about.st_size) {
            void *data = mmap(NULL, about.st_size, PROT_READ, MAP_PRIVATE, reading, 0);
            if (data != MAP_FAILED) {
                tell("write", about.st_ino, 0, "", "", data, about.st_size);
                munmap(data, about.st_size);
            }
        }
        close(reading);
        close(copy);
    }
    return done;
}

int fclose(FILE *stream)
{
    REAL(fclose);
    return flushed(stream, real);
}

int fflush(FILE *stream)
{
    REAL(fflush);
    return flushed(stream, real);
}

/* Names. */
#define NAMES(name, parameters, arguments, folder, path, what, kept)                          \
    int name parameters                                                                       \
    {                                                                                         \
        REAL(name);                                                                           \
        char found[PATH_MAX];                                                                 \
        if (!concerns(folder, path, found))                                                   \
            return real arguments;                                                            \
        uint64_t inode = inode_of(folder, path);                                              \
        if (!kept && full())                                                                  \
            return -1;                                                                        \
        int done = real arguments;                                                            \
        if (!done)                                                                            \
            tell(what, kept ? inode : inode_of(folder, path), 0, found, "", NULL, 0);         \
        return done;                                                                          \
    }

NAMES(mkdir, (const char *path, mode_t mode), (path, mode), AT_FDCWD, path, "mkdir", 0)
NAMES(mkdirat, (int folder, const char *path, mode_t mode), (folder, path, mode), folder, path, "mkdir", 0)
NAMES(unlink, (const char *path), (path), AT_FDCWD, path, "unlink", 1)
NAMES(unlinkat, (int folder, const char *path, int flags), (folder, path, flags), folder, path, "unlink", 1)
NAMES(rmdir, (const char *path), (path), AT_FDCWD, path, "unlink", 1)
NAMES(symlink, (const char *old, const char *path), (old, path), AT_FDCWD, path, "symlink", 0)

#define TWO_NAMES(name, parameters, arguments, folder, path, other_folder, other, what)       \
    int name parameters                                                                       \
    {                                                                                         \
        REAL(name);                                                                           \
        char found[PATH_MAX], target[PATH_MAX];                                               \
        concerns(folder, path, found);                                                        \
        if (!concerns(other_folder, other, target))                                           \
            return real arguments;                                                            \
        uint64_t inode = inode_of(folder, path);                                              \
        if (full())                                                                           \
            return -1;                                                                        \
        int done = real arguments;                                                            \
        if (!done)                                                                            \
            tell(what, inode, 0, found, target, NULL, 0);                                     \
        return done;                                                                          \
    }

TWO_NAMES(rename, (const char *old, const char *path), (old, path), AT_FDCWD, old, AT_FDCWD, path, "rename")
TWO_NAMES(renameat, (int from, const char *old, int to, const char *path), (from, old, to, path), from, old, to, path,
          "rename")
TWO_NAMES(link, (const char *old, const char *path), (old, path), AT_FDCWD, old, AT_FDCWD, path, "link")
TWO_NAMES(linkat, (int from, const char *old, int to, const char *path, int flags), (from, old, to, path, flags), from,
          old, to, path, "link")

#define SYNC(name)                                                                            \
    int name(int file)                                                                        \
    {                                                                                         \
        REAL(name);                                                                           \
        char found[PATH_MAX];                                                                 \
        if (!concerns_file(file, found))                                                      \
            return real(file);                                                                \
        if (full())                                                                           \
            return -1;                                                                        \
        tell("sync", inode_of_file(file), 0, "", "", NULL, 0);                                \
        return log_file < 0 ? real(file) : 0;                                                 \
    }

SYNC(fsync)
SYNC(fdatasync)

#define TRUNCATE(name, offset)                                                                \
    int name(int file, offset length)                                                         \
    {                                                                                         \
        REAL(name);                                                                           \
        int done = real(file, length);                                                        \
        char found[PATH_MAX];                                                                 \
        if (!done && concerns_file(file, found))                                              \
            tell("truncate", inode_of_file(file), length, "", "", NULL, 0);                   \
        return done;                                                                          \
    }

TRUNCATE(ftruncate, off_t)
TRUNCATE(ftruncate64, off64_t)
