// A Vulkan layer that offers VK_KHR_workgroup_memory_explicit_layout on drivers without it.
//
// CubeCL 0.11 writes shared memory into SPIR-V in two forms. Cards have the extension and take the valid form. Without it CubeCL
// writes a pointer to a pointer (docs/DEVICES.md, "SPIR-V"), which crashes Mesa's drivers in software. Mesa 25's driver reads the
// valid form, so the extension's name is all that it lacks. `.ci/run spirv` compiles and uses this layer.
#include <stdlib.h>
#include <string.h>
#include <vulkan/vk_layer.h>
#include <vulkan/vulkan.h>

#define NAME VK_KHR_WORKGROUP_MEMORY_EXPLICIT_LAYOUT_EXTENSION_NAME
#define FEATURES VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_WORKGROUP_MEMORY_EXPLICIT_LAYOUT_FEATURES_KHR

// Functions of the next layer or of the driver. Later instances have the same.
static VkInstance instance;
static PFN_vkGetInstanceProcAddr next_instance_proc;
static PFN_vkGetDeviceProcAddr next_device_proc;
static PFN_vkEnumerateDeviceExtensionProperties next_extensions;
static PFN_vkGetPhysicalDeviceFeatures2 next_features;

static VKAPI_ATTR VkResult VKAPI_CALL create_instance(
    const VkInstanceCreateInfo *info, const VkAllocationCallbacks *allocator, VkInstance *created) {
  VkLayerInstanceCreateInfo *link = (VkLayerInstanceCreateInfo *)info->pNext;
  while (link && !(link->sType == VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO && link->function == VK_LAYER_LINK_INFO))
    link = (VkLayerInstanceCreateInfo *)link->pNext;
  if (!link) return VK_ERROR_INITIALIZATION_FAILED;
  next_instance_proc = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  VkResult result = ((PFN_vkCreateInstance)next_instance_proc(NULL, "vkCreateInstance"))(info, allocator, created);
  if (result != VK_SUCCESS) return result;
  instance = *created;
  next_extensions = (PFN_vkEnumerateDeviceExtensionProperties)next_instance_proc(instance, "vkEnumerateDeviceExtensionProperties");
  next_features = (PFN_vkGetPhysicalDeviceFeatures2)next_instance_proc(instance, "vkGetPhysicalDeviceFeatures2");
  return VK_SUCCESS;
}

static VKAPI_ATTR VkResult VKAPI_CALL extensions(
    VkPhysicalDevice device, const char *layer, uint32_t *count, VkExtensionProperties *properties) {
  if (layer) return next_extensions(device, layer, count, properties);
  uint32_t real = 0;
  VkResult result = next_extensions(device, NULL, &real, NULL);
  if (result != VK_SUCCESS) return result;
  if (!properties) {
    *count = real + 1;
    return VK_SUCCESS;
  }
  uint32_t taken = *count < real ? *count : real;
  result = next_extensions(device, NULL, &taken, properties);
  if (result == VK_SUCCESS && *count > taken) {
    memset(&properties[taken], 0, sizeof *properties);
    strcpy(properties[taken].extensionName, NAME);
    properties[taken++].specVersion = 1;
  }
  VkResult complete = taken == real + 1 ? VK_SUCCESS : VK_INCOMPLETE;
  *count = taken;
  return result == VK_SUCCESS ? complete : result;
}

static VKAPI_ATTR void VKAPI_CALL features(VkPhysicalDevice device, VkPhysicalDeviceFeatures2 *asked) {
  next_features(device, asked);
  for (VkBaseOutStructure *s = (VkBaseOutStructure *)asked->pNext; s; s = s->pNext)
    if (s->sType == FEATURES) ((VkPhysicalDeviceWorkgroupMemoryExplicitLayoutFeaturesKHR *)s)->workgroupMemoryExplicitLayout = VK_TRUE;
}

// Takes the extension out again: the driver would refuse it.
static VKAPI_ATTR VkResult VKAPI_CALL create_device(
    VkPhysicalDevice device, const VkDeviceCreateInfo *info, const VkAllocationCallbacks *allocator, VkDevice *created) {
  VkLayerDeviceCreateInfo *link = (VkLayerDeviceCreateInfo *)info->pNext;
  while (link && !(link->sType == VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO && link->function == VK_LAYER_LINK_INFO))
    link = (VkLayerDeviceCreateInfo *)link->pNext;
  if (!link) return VK_ERROR_INITIALIZATION_FAILED;
  PFN_vkGetInstanceProcAddr proc = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  next_device_proc = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;

  VkDeviceCreateInfo kept = *info;
  const char **names = malloc((info->enabledExtensionCount + 1) * sizeof *names);
  if (!names) return VK_ERROR_OUT_OF_HOST_MEMORY;
  kept.ppEnabledExtensionNames = names;
  kept.enabledExtensionCount = 0;
  for (uint32_t i = 0; i < info->enabledExtensionCount; i++)
    if (strcmp(info->ppEnabledExtensionNames[i], NAME)) names[kept.enabledExtensionCount++] = info->ppEnabledExtensionNames[i];
  for (VkBaseOutStructure *s = (VkBaseOutStructure *)&kept; s->pNext;)
    if (s->pNext->sType == FEATURES)
      s->pNext = s->pNext->pNext;
    else
      s = s->pNext;
  VkResult result = ((PFN_vkCreateDevice)proc(instance, "vkCreateDevice"))(device, &kept, allocator, created);
  free(names);
  return result;
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL device_proc(VkDevice device, const char *name) { return next_device_proc(device, name); }

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL instance_proc(VkInstance of, const char *name) {
  static const struct {
    const char *name;
    PFN_vkVoidFunction function;
  } own[] = {
      {"vkGetInstanceProcAddr", (PFN_vkVoidFunction)instance_proc},
      {"vkGetDeviceProcAddr", (PFN_vkVoidFunction)device_proc},
      {"vkCreateInstance", (PFN_vkVoidFunction)create_instance},
      {"vkCreateDevice", (PFN_vkVoidFunction)create_device},
      {"vkEnumerateDeviceExtensionProperties", (PFN_vkVoidFunction)extensions},
      {"vkGetPhysicalDeviceFeatures2", (PFN_vkVoidFunction)features},
      {"vkGetPhysicalDeviceFeatures2KHR", (PFN_vkVoidFunction)features},
  };
  for (size_t i = 0; i < sizeof own / sizeof *own; i++)
    if (!strcmp(own[i].name, name)) return own[i].function;
  return next_instance_proc ? next_instance_proc(of, name) : NULL;
}

VKAPI_ATTR VkResult VKAPI_CALL vkNegotiateLoaderLayerInterfaceVersion(VkNegotiateLayerInterface *version) {
  version->loaderLayerInterfaceVersion = 2;
  version->pfnGetInstanceProcAddr = instance_proc;
  version->pfnGetDeviceProcAddr = device_proc;
  version->pfnGetPhysicalDeviceProcAddr = NULL;
  return VK_SUCCESS;
}
